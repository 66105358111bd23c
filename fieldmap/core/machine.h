/* machine.h: a body with magnets, the coils that move it, and the field of their currents.
 *
 * In double precision.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MACHINE_H
#define FIELDMAP_MACHINE_H

#include "electrical.h"
#include "instruments.h"
#include "rigid_body.h"

/* field: with `weights` of its own, which follow the currents by `superposition`. seen_at: the point of the body that
 * sensors see. windings, drives: of each coil. electrical: of coupled coils, in the place of the windings, or NULL. scratch:
 * room for n_coils numbers. */
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

/* The field becomes that of these currents; whether they lie where it is known how it follows them. */
static inline int fieldmap_machine_follow(fieldmap_machine *machine, const double *currents)
{
    const int within = fieldmap_follow(&machine->superposition, currents, machine->weights);
    fieldmap_path_forget(&machine->field);
    return within;
}

/* out[3]: where the point of the body that is seen lies in the map. */
static inline void fieldmap_sensed_point(const fieldmap_machine *machine, const fieldmap_state *state, double *out)
{
    double r[9], arm[3];
    int i;
    fieldmap_rotation(state->turn, r);
    fieldmap_to_map(r, machine->seen_at, arm);
    for (i = 0; i < 3; i++) out[i] = state->position[i] + arm[i];
}

/* Begin a run of coupled coils at a state and currents. The status of the map. */
static inline int fieldmap_coupled_begin(fieldmap_machine *machine, const fieldmap_state *state, const double *currents)
{
    double r[9];
    fieldmap_machine_follow(machine, currents);
    fieldmap_rotation(state->turn, r);
    return fieldmap_electrical_begin(machine->electrical, &machine->superposition, &machine->field, &machine->body.magnetic,
                                     state->position, r, currents);
}

/* A step of second order of the body and of coupled coils. load[6] goes in as that at the beginning and comes out as that at
 * the end. held: set if a limit holds; within: as fieldmap_machine_follow. The status of the map. */
static inline int fieldmap_coupled_step(fieldmap_machine *machine, double h, const double *commands, fieldmap_state *state,
                                        double *currents, double *load, int *held, int *within, int *touched)
{
    double per[6], r[9];
    int status = FIELDMAP_OK;
    *touched = FIELDMAP_FREE;
    if (!machine->electrical->known) status = fieldmap_coupled_begin(machine, state, currents);
    if (status != FIELDMAP_OK) return status;
    /* The currents move while the body flies; without resistance and voltage the step is symplectic. */
    fieldmap_leave(&machine->body, per, r, state, load, h, 2);
    status = fieldmap_drive_coils(machine->electrical, &machine->superposition, &machine->field, &machine->body.magnetic,
                                  state->position, r, commands, h, currents, machine->weights, held, within);
    if (status != FIELDMAP_OK) return status;
    return fieldmap_arrive(&machine->field, &machine->body, per, r, state, load, h, 2, touched);
}

/* A motion at weights that do not change: rows of states, the first after no step, each after `every` steps of h more.
 * Rows that were filled; the status of the map, and what was touched by then. The state is advanced. */
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

/* One control period of `steps` steps of h at commands[n_coils], for controllers that call once a sample. load[6]: that of
 * the state as it comes in. The status of the map. */
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
            /* Where currents jump, the load at the beginning is that of the new ones. */
            if (at_once && step == 0) status = fieldmap_load(&machine->field, &machine->body, state, load, &touched);
        }
        if (status == FIELDMAP_OK)
            status = fieldmap_step(&machine->field, &machine->body, state, load, h, 2, &touched);
    }
    return status;
}

#endif
