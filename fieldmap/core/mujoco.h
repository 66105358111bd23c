/* mujoco.h: magnets in MuJoCo, for its callback of passive forces.
 *
 * MuJoCo's headers are not needed: a task holds the offsets of arrays in MuJoCo's data, and the address of its function that
 * applies a force. Only the model and the first fault of a task are written, so several threads may step at a time.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MUJOCO_H
#define FIELDMAP_MUJOCO_H

#include <string.h>

#include "bodies.h"

/* mj_applyFT(model, data, force, torque, point, body, generalised force) */
typedef void fieldmap_mujoco_apply(
    const void *model, void *data, const double *force, const double *torque, const double *point, int body, double *target);

/* A magnet on body number `number` of MuJoCo. freedom: first degree of freedom if the only joint is a free joint, else -1. */
typedef struct fieldmap_mujoco_magnet {
    const fieldmap_magnetic_body *body;
    int number, freedom;
} fieldmap_mujoco_magnet;

/* model: MuJoCo's model, or NULL; the next call then sets it, and does nothing else. xpos, xmat, passive: offsets of the
 * pointers to xpos, xmat and qfrc_passive in MuJoCo's data, bytes. field: keeps no sums (places NULL); its weights may be
 * changed between steps. origin: of the map in the world, m. mutual: whether magnets act on each other. points: of all magnets.
 * status: FIELDMAP_OK, or the status of the first fault. After a fault no forces are added; at_fault is the number of the
 * magnet, and place[3] its point in the map. */
typedef struct fieldmap_mujoco_task {
    const void *model;
    fieldmap_mujoco_apply *apply;
    size_t xpos, xmat, passive;
    fieldmap_path field;
    double origin[3];
    int mutual, count, points;
    const fieldmap_mujoco_magnet *magnets;
    int status, at_fault;
    double place[3];
} fieldmap_mujoco_task;

/* The array of a pointer at an offset in MuJoCo's data. */
static inline double *fieldmap_mujoco_array(const void *data, size_t offset)
{
    double *array;
    memcpy(&array, (const char *)data + offset, sizeof array);
    return array;
}

/* Bytes of room that the callback needs. */
static inline size_t fieldmap_mujoco_room(const fieldmap_mujoco_task *task)
{
    const size_t points = task->mutual ? (size_t)task->points : 0, count = (size_t)task->count;
    return count * (sizeof(fieldmap_placed) + 6 * sizeof(double)) + points * sizeof(fieldmap_site)
        + fieldmap_looked_room(task->field.map, (int)points) * sizeof(double);
}

/* Fill wrench[6 * count] on all magnets at given poses. Returns a status; fills magnet and point of a fault. */
static inline int fieldmap_mujoco_wrenches(
    const fieldmap_mujoco_task *task, fieldmap_placed *placed, double *wrench, int *at_fault, double *at)
{
    int n, k, fault, status = FIELDMAP_OK;
    if (task->mutual) {
        fieldmap_site *sites = (fieldmap_site *)(wrench + 6 * task->count);
        fieldmap_bodies all = {task->count, task->points, placed, sites, {0, NULL, NULL, NULL}, {0, 0, NULL, NULL}, {0.0}};
        status = fieldmap_wrench_in_map(&all, &task->field, (double *)(sites + task->points), wrench, NULL, &fault);
        if (status == FIELDMAP_OK) return status;
        *at_fault = sites[fault].owner;
        for (k = 0; k < 3; k++) at[k] = sites[fault].at[k];
    }
    for (n = 0; n < task->count && status == FIELDMAP_OK && !task->mutual; n++) {
        status = fieldmap_body_wrench(&task->field, placed[n].body, placed[n].place, placed[n].turn, wrench + 6 * n, at);
        *at_fault = n;
    }
    return status;
}

/* Add the load of every magnet to the passive forces of MuJoCo's data. room: fieldmap_mujoco_room() bytes of this thread. */
static inline void fieldmap_mujoco_add_forces(fieldmap_mujoco_task *task, const void *model, void *data, void *room)
{
    fieldmap_placed *placed = (fieldmap_placed *)room;
    double *wrench = (double *)(placed + task->count), *passive, at[3];
    const double *xpos, *xmat;
    int n, k, at_fault = 0, status;
    if (task->model == NULL) {
        task->model = model;
        return;
    }
    if (task->status != FIELDMAP_OK || task->model != model) return;
    xpos = fieldmap_mujoco_array(data, task->xpos), xmat = fieldmap_mujoco_array(data, task->xmat);
    passive = fieldmap_mujoco_array(data, task->passive);
    for (n = 0; n < task->count; n++) {
        const int number = task->magnets[n].number;
        placed[n].body = task->magnets[n].body;
        for (k = 0; k < 3; k++) placed[n].place[k] = xpos[3 * number + k] - task->origin[k];
        memcpy(placed[n].turn, xmat + 9 * number, sizeof placed[n].turn);
    }
    status = fieldmap_mujoco_wrenches(task, placed, wrench, &at_fault, at);
    if (status != FIELDMAP_OK) {
        for (k = 0; k < 3; k++) task->place[k] = at[k];
        task->at_fault = at_fault;
        task->status = status;
        return;
    }
    for (n = 0; n < task->count; n++, wrench += 6) {
        const fieldmap_mujoco_magnet *magnet = task->magnets + n;
        if (magnet->freedom < 0) {
            task->apply(model, data, wrench, wrench + 3, xpos + 3 * magnet->number, magnet->number, passive);
        } else {
            /* The same as mj_applyFT: force in the world, torque in the body. */
            double torque[3];
            fieldmap_to_body(placed[n].turn, wrench + 3, torque);
            fieldmap_add(wrench, passive + magnet->freedom);
            fieldmap_add(torque, passive + magnet->freedom + 3);
        }
    }
}

#endif
