/* sampled_loop.h: a sampled linear plant in closed loop with a controller and its instruments.
 *
 *     x[n+1] = A x[n] + B (i[n] - i_0 + disturbance[n])     y[n] = C x[n]
 *
 * y: deviation of the position from an operating point; u: deviation of the controller's output; i: current of the drive; i_0:
 * current of the drive's gain and offset at the operating output. y[n] does not depend on u[n].
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_SAMPLED_LOOP_H
#define FIELDMAP_SAMPLED_LOOP_H

#include "controller.h"

/* A, row by row, B and C, of one input and one output. */
typedef struct fieldmap_plant {
    int states;
    const double *A, *B, *C;
} fieldmap_plant;

/* Instruments, and the operating point from which the loop's signals deviate. Steps and limits of instruments are absolute. */
typedef struct fieldmap_loop_instruments {
    fieldmap_chain chain;
    fieldmap_drive drive;
    double position, output;
} fieldmap_loop_instruments;

/* Inputs of the loop at a sample: reference, noise of the position, of the converter's voltage and of the current, and
 * disturbance of the plant's input. */
typedef struct fieldmap_loop_inputs {
    double reference, position_noise, voltage_noise, current_noise, disturbance;
} fieldmap_loop_inputs;

/* Numbers of scratch that a sample needs. */
static inline int fieldmap_loop_scratch(const fieldmap_plant *plant, const fieldmap_controller *controller)
{
    return plant->states + fieldmap_controller_scratch(controller);
}

/* One sample with a controller of one output: fill u, advance the state x[] of the plant and the memory[] of the controller,
 * and return y. Reference and measured position are used for all three axes of the controller's signals. */
static inline double fieldmap_loop_sample(const fieldmap_plant *plant, const fieldmap_controller *controller,
                                          const fieldmap_loop_instruments *with, const fieldmap_loop_inputs *in, double *x,
                                          double *memory, double *scratch, double *u)
{
    const int states = plant->states;
    const fieldmap_between whole = {0, 0.0};
    const double y = fieldmap_row_times(plant->C, whole, 1, states, 0, x), no_feedforward = 0.0;
    const double sensed = with->position + y + in->position_noise;
    const double seen = fieldmap_measure(&with->chain, sensed, in->voltage_noise) - with->position;
    const double v[FIELDMAP_SIGNALS] = {in->reference, in->reference, in->reference, seen, seen, seen, 1.0};
    double *after = scratch + fieldmap_controller_scratch(controller), input;
    int i;
    fieldmap_control(controller, v, &no_feedforward, memory, scratch, u);
    input = fieldmap_driven(&with->drive, with->output + *u, in->current_noise)
        - (with->drive.gain * with->output + with->drive.offset) + in->disturbance;
    for (i = 0; i < states; i++) after[i] = plant->B[i] * input + fieldmap_row_times(plant->A, whole, states, states, i, x);
    for (i = 0; i < states; i++) x[i] = after[i];
    return y;
}

#endif
