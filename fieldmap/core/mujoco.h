/* mujoco.h: magnets in MuJoCo, for its callback of passive forces.
 *
 * MuJoCo's headers are not needed: where its data keeps arrays, and its function that applies a force, are told by who
 * makes a task. Nothing of a task is written but the model and the first fault, so several threads may step at a time.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MUJOCO_H
#define FIELDMAP_MUJOCO_H

#include <string.h>

#include "magnetic_body.h"

/* mj_applyFT(model, data, force, torque, point, body, generalised force) */
typedef void fieldmap_mujoco_apply(
    const void *model, void *data, const double *force, const double *torque, const double *point, int body, double *target);

/* A magnet on body number `number` of MuJoCo. freedom: the body's first degree of freedom where a free joint is all that it
 * hangs on, else -1. */
typedef struct fieldmap_mujoco_magnet {
    const fieldmap_magnetic_body *body;
    int number, freedom;
} fieldmap_mujoco_magnet;

/* model: MuJoCo's, or NULL: the next call says it, and does nothing else. xpos, xmat, passive: where in MuJoCo's data the
 * pointers to xpos, xmat and qfrc_passive lie, in bytes. field: which keeps nothing (places NULL); its weights may be changed
 * between steps. origin: of the map in the world, m. mutual: whether the dipoles of magnets act on those of others. status:
 * FIELDMAP_OK, or that of the first point at which the field was not known; then no forces are added any more, at_fault says
 * which magnet it was, and place[3] the point in the map. */
typedef struct fieldmap_mujoco_task {
    const void *model;
    fieldmap_mujoco_apply *apply;
    size_t xpos, xmat, passive;
    fieldmap_path field;
    double origin[3];
    int mutual, count;
    const fieldmap_mujoco_magnet *magnets;
    int status, at_fault;
    double place[3];
} fieldmap_mujoco_task;

/* The array to which a pointer in MuJoCo's data leads. */
static inline double *fieldmap_mujoco_array(const void *data, size_t offset)
{
    double *array;
    memcpy(&array, (const char *)data + offset, sizeof array);
    return array;
}

/* Add to wrench[6] on magnet n, about the origin of its body, what the dipoles of all others do to its own. */
static inline void fieldmap_mujoco_add_others(
    const fieldmap_mujoco_task *task, const double *xpos, const double *xmat, int n, double *wrench)
{
    const fieldmap_mujoco_magnet *own = task->magnets + n;
    const double *turn = xmat + 9 * own->number, *centre = xpos + 3 * own->number;
    int p, q, k, other;
    for (p = 0; p < own->body->n_dipoles; p++) {
        double arm[3], moment[3], flux[3] = {0.0}, force[3] = {0.0};
        fieldmap_to_map(turn, own->body->dipoles[p].point, arm);
        fieldmap_to_map(turn, own->body->dipoles[p].moment, moment);
        for (other = 0; other < task->count; other++) {
            const fieldmap_mujoco_magnet *by = task->magnets + other;
            const double *its_turn = xmat + 9 * by->number, *its_centre = xpos + 3 * by->number;
            for (q = 0; q < (other == n ? 0 : by->body->n_dipoles); q++) {
                double its_arm[3], source[3], r[3];
                fieldmap_to_map(its_turn, by->body->dipoles[q].point, its_arm);
                fieldmap_to_map(its_turn, by->body->dipoles[q].moment, source);
                for (k = 0; k < 3; k++) r[k] = centre[k] + arm[k] - its_centre[k] - its_arm[k];
                fieldmap_add_dipole(r, source, moment, flux, force);
            }
        }
        fieldmap_add(force, wrench);
        fieldmap_add_cross(moment, flux, wrench + 3);
        fieldmap_add_cross(arm, force, wrench + 3);
    }
}

/* Add the load of every magnet to the passive forces of MuJoCo's data. */
static inline void fieldmap_mujoco_add_forces(fieldmap_mujoco_task *task, const void *model, void *data)
{
    const double *xpos, *xmat;
    double *passive;
    int n, k;
    if (task->model == NULL) {
        task->model = model;
        return;
    }
    if (task->status != FIELDMAP_OK || task->model != model) return;
    xpos = fieldmap_mujoco_array(data, task->xpos), xmat = fieldmap_mujoco_array(data, task->xmat);
    passive = fieldmap_mujoco_array(data, task->passive);
    for (n = 0; n < task->count; n++) {
        const fieldmap_mujoco_magnet *magnet = task->magnets + n;
        const double *turn = xmat + 9 * magnet->number, *centre = xpos + 3 * magnet->number;
        double place[3], at[3], wrench[6];
        int status;
        for (k = 0; k < 3; k++) place[k] = centre[k] - task->origin[k];
        status = fieldmap_body_wrench(&task->field, magnet->body, place, turn, wrench, at);
        if (status != FIELDMAP_OK) {
            for (k = 0; k < 3; k++) task->place[k] = at[k];
            task->at_fault = n;
            task->status = status;
            return;
        }
        if (task->mutual) fieldmap_mujoco_add_others(task, xpos, xmat, n, wrench);
        if (magnet->freedom < 0) {
            task->apply(model, data, wrench, wrench + 3, centre, magnet->number, passive);
        } else {
            /* What mj_applyFT would do: force in the world, torque in the body. */
            double torque[3];
            fieldmap_to_body(turn, wrench + 3, torque);
            fieldmap_add(wrench, passive + magnet->freedom);
            fieldmap_add(torque, passive + magnet->freedom + 3);
        }
    }
}

#endif
