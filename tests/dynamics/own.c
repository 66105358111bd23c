/* Controllers in C: the PID of test_own_controllers.py with its gains KP, KI, KD, and functions that fail. */

int control(double time, const double *measured, const double *reference, double *state, double *outputs)
{
    double error = 1e3 * (reference[2] - measured[2]);
    state[0] += KI * 0.5 * (error + state[1]);
    outputs[0] = KP * error + state[0] + KD * (error - state[2]);
    state[1] = state[2] = error;
    return 0;
}

int refuse(double time, const double *measured, const double *reference, double *state, double *outputs)
{
    outputs[0] = 5.0;
    return time > 0.0391 ? 7 : 0;
}

int outputs_too(double time, const double *measured, const double *reference, double *state, double *outputs)
{
    for (int k = 0; k < 40; k++) outputs[k] = 5.0;
    return 0;
}

int reads(double time, const double *measured, const double *reference, double *state, double *outputs)
{
    outputs[0] = 5.0 + 0.0 * state[12];
    return 0;
}
