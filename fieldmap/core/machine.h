/* machine.h: a body with magnets, the coils that move it, and the field of their currents.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MACHINE_H
#define FIELDMAP_MACHINE_H

#include "electrical.h"
#include "instruments.h"
#include "rigid_body.h"

/* field: its `weights` follow the currents by `superposition`. seen_at: the sensed point in the body. windings, drives: of each
 * coil. electrical: coupled coils, which replace the windings, or NULL. scratch: room for n_coils numbers. */
typedef struct fieldmap_machine {
    fieldmap_path field;
    double *weights, *scratch;
    fieldmap_superposition superposition;
    fieldmap_rigid_body body;
    double seen_at[3];
    int n_coils;
    const fieldmap_winding *windings;
    const fieldmap_drive *drives;
    fieldmap_electrical *electrical;
} fieldmap_machine;

/* Set the field to that of currents. Returns whether they lie in the table or the domain of the iron. */
static inline int fieldmap_machine_follow(fieldmap_machine *machine, const double *currents)
{
    const int within = fieldmap_follow(&machine->superposition, currents, machine->weights);
    fieldmap_path_forget(&machine->field);
    return within;
}

/* Fill out[3]: the sensed point of the body in the map. */
static inline void fieldmap_sensed_point(const fieldmap_machine *machine, const fieldmap_state *state, double *out)
{
    double r[9], arm[3];
    int i;
    fieldmap_rotation(state->turn, r);
    fieldmap_to_map(r, machine->seen_at, arm);
    for (i = 0; i < 3; i++) out[i] = state->position[i] + arm[i];
}

/* Begin a run of coupled coils at a state and currents. Returns the status of the map. */
static inline int fieldmap_coupled_begin(fieldmap_machine *machine, const fieldmap_state *state, const double *currents)
{
    double r[9];
    fieldmap_machine_follow(machine, currents);
    fieldmap_rotation(state->turn, r);
    return fieldmap_electrical_begin(machine->electrical, &machine->superposition, &machine->field, &machine->body.magnetic,
                                     state->position, r, currents);
}

/* A step of second order of the body and of coupled coils. load[6] is the load at the beginning, and afterwards the load at the
 * end. held: set if a limit is active; within: as fieldmap_machine_follow returns. Returns the status of the map. */
static inline int fieldmap_coupled_step(fieldmap_machine *machine, double h, const double *commands, fieldmap_state *state,
                                        double *currents, double *load, int *held, int *within, int *touched)
{
    double per[6], r[9];
    int status = FIELDMAP_OK;
    *touched = FIELDMAP_FREE;
    if (!machine->electrical->known) status = fieldmap_coupled_begin(machine, state, currents);
    if (status != FIELDMAP_OK) return status;
    /* The currents change between the half kicks; without resistance and voltage the step is symplectic. */
    fieldmap_leave(&machine->body, per, r, state, load, h, 2);
    status = fieldmap_drive_coils(machine->electrical, &machine->superposition, &machine->field, &machine->body.magnetic,
                                  state->position, r, commands, h, currents, machine->weights, held, within);
    if (status != FIELDMAP_OK) return status;
    return fieldmap_arrive(&machine->field, &machine->body, per, r, state, load, h, 2, touched);
}

/* A motion at constant weights. Fills rows of states: the first is the start, and each later one follows after `every` steps of
 * h. Advances the state, and fills the status of the map and the contacts so far. Returns the number of rows filled. */
static inline long fieldmap_move(fieldmap_machine *machine, fieldmap_state *state, double h, long every, int order,
                                 long rows, fieldmap_state *states, int *status, int *touched)
{
    double load[6] = {0.0};
    long row, n;
    int now;
    *status = fieldmap_load(&machine->field, &machine->body, state, load, touched);
    states[0] = *state;
    for (row = 1; row < rows && *status == FIELDMAP_OK; row++) {
        for (n = 0; n < every && *status == FIELDMAP_OK; n++) {
            *status = fieldmap_step(&machine->field, &machine->body, state, load, h, order, &now);
            *touched |= now;
        }
        if (*status != FIELDMAP_OK) break;
        states[row] = *state;
    }
    return row;
}

/* One control period of `steps` steps of h at commands[n_coils], for controllers that call once a sample. load[6]: the load at
 * the beginning, and afterwards the load at the end. Returns the status of the map. */
static inline int fieldmap_advance(fieldmap_machine *machine, double h, long steps, const double *commands,
                                   fieldmap_state *state, double *currents, double *load)
{
    const int at_once = fieldmap_at_once(machine->windings, machine->n_coils);
    int held, moved, within, touched, status = FIELDMAP_OK;
    long step;
    for (step = 0; step < steps && status == FIELDMAP_OK && machine->electrical != NULL; step++)
        status = fieldmap_coupled_step(machine, h, commands, state, currents, load, &held, &within, &touched);
    if (machine->electrical != NULL) {
        fieldmap_warm(machine->electrical, h * (double)steps);
        return status;
    }
    for (step = 0; step < steps && status == FIELDMAP_OK; step++) {
        fieldmap_advance_currents(machine->windings, machine->n_coils, commands, currents, &held, &moved);
        if (moved) {
            fieldmap_machine_follow(machine, currents);
            /* If the currents jump, the load at the beginning belongs to the new currents. */
            if (at_once && step == 0) status = fieldmap_load(&machine->field, &machine->body, state, load, &touched);
        }
        if (status == FIELDMAP_OK)
            status = fieldmap_step(&machine->field, &machine->body, state, load, h, 2, &touched);
    }
    return status;
}

#endif
