/* In the place of Simulink: calls the S-function as it would, on rows of position and currents from stdin. */
#include <stdio.h>

int main(int argc, char **argv)
{
    mxArray path = {NULL, {0}, 0}, moment = {NULL, {0.1, -0.2, 0.8}, 3};
    double position[3], currents[64], flux[3], gradient[9], wrench[6];
    SimStruct S;
    path.text = argc > 1 ? argv[1] : "";
    memset(&S, 0, sizeof S);
    S.parameters[0] = &path, S.parameters[1] = &moment;
    S.input[0] = position, S.input[1] = currents, S.output[0] = flux, S.output[1] = gradient, S.output[2] = wrench;
    mdlInitializeSizes(&S);
    if (S.error == NULL && S.input_width[1] <= 64) {
        mdlInitializeSampleTimes(&S);
        mdlStart(&S);
        while (S.error == NULL && fread(position, 8, 3, stdin) == 3
               && fread(currents, 8, (size_t)S.input_width[1], stdin) == (size_t)S.input_width[1]) {
            mdlOutputs(&S, 0);
            if (S.error != NULL) break;
            fwrite(flux, 8, 3, stdout);
            fwrite(gradient, 8, 9, stdout);
            fwrite(wrench, 8, 6, stdout);
        }
        mdlTerminate(&S);
    }
    if (S.error != NULL) fprintf(stderr, "%s\n", S.error);
    return S.error != NULL;
}
