/* python_mujoco.h: magnets in MuJoCo, for Python: see fieldmap.core.mujoco.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_MUJOCO_H
#define FIELDMAP_PYTHON_MUJOCO_H

#include <stdlib.h>

#include "mujoco.h"
#include "python_body.h"
#include "python_map.h"

static const char *const MUJOCO = "fieldmap.core.mujoco";

/* The active task of the callback, and the capsule that holds it. MuJoCo has only one callback. */
static fieldmap_mujoco_task *active_task = NULL;
static PyObject *active_capsule = NULL;

/* The callback of MuJoCo: mjfGeneric mjcb_passive. Each thread that steps has its own memory. */
static void add_passive_forces(const void *model, void *data)
{
    double few[512];
    const size_t bytes = active_task == NULL ? 0 : fieldmap_mujoco_room(active_task);
    void *room = bytes > sizeof few ? malloc(bytes) : few;
    if (active_task != NULL && room != NULL) fieldmap_mujoco_add_forces(active_task, model, data, room);
    else if (active_task != NULL) active_task->status = FIELDMAP_NO_MEMORY;
    if (room != few) free(room);
}

/* magnets: tuples (body, number, freedom). */
static void read_magnets(reader *from, fieldmap_mujoco_task *task)
{
    PyObject *magnets = value_of(from, "magnets");
    const Py_ssize_t count = magnets != NULL && PyTuple_Check(magnets) ? PyTuple_Size(magnets) : 0;
    fieldmap_mujoco_magnet *read = (fieldmap_mujoco_magnet *)memory_of(from, (size_t)count * sizeof *read);
    Py_ssize_t n;
    require(magnets != NULL && PyTuple_Check(magnets), PyExc_TypeError, "magnets must be a tuple");
    for (n = 0; n < count && !PyErr_Occurred(); n++) {
        PyObject *body;
        if (PyArg_ParseTuple(PyTuple_GetItem(magnets, n), "Oii", &body, &read[n].number, &read[n].freedom))
            read[n].body = (const fieldmap_magnetic_body *)PyCapsule_GetPointer(body, BODY);
        if (!PyErr_Occurred()) task->points += fieldmap_body_points(read[n].body);
    }
    task->magnets = read, task->count = (int)count;
}

/* The array of the weights is used in place, not copied. */
static void read_task(reader *from, void *out)
{
    fieldmap_mujoco_task *task = (fieldmap_mujoco_task *)out;
    reader layout;
    task->field.map = (const fieldmap *)held_of(from, "map", MAP);
    task->field.weights = numbers_of(from, "weights", 1, task->field.map == NULL ? 0 : task->field.map->n_coils).at;
    read_magnets(from, task);
    layout = part_of(from, "layout");
    task->apply = (fieldmap_mujoco_apply *)address_of(&layout, "apply");
    task->xpos = address_of(&layout, "xpos"), task->xmat = address_of(&layout, "xmat");
    task->passive = address_of(&layout, "passive");
    copy_of(from, "origin", 1, 3, task->origin);
    task->mutual = truth_of(from, "mutual");
}

/* mujoco_task(map, weights, magnets, layout, origin, mutual): see fieldmap.core.mujoco. */
static PyObject *mujoco_task(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 6);
    (void)self;
    return held(&from, MUJOCO, sizeof(fieldmap_mujoco_task), read_task);
}

/* mujoco_activate(task or None): the task that was active before, or None. */
static PyObject *mujoco_activate(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    PyObject *before = active_capsule;
    reader from = arguments(args, given, 1);
    fieldmap_mujoco_task *task = (fieldmap_mujoco_task *)held_or_none(&from, "task", MUJOCO);
    (void)self;
    if (PyErr_Occurred()) return NULL;
    active_task = task;
    active_capsule = task == NULL ? NULL : args[0];
    Py_XINCREF(active_capsule);
    if (before != NULL) return before;
    Py_RETURN_NONE;
}

/* mujoco_begin(task): clear the fault and the model; the next call sets the model. */
static PyObject *mujoco_begin(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    fieldmap_mujoco_task *task = (fieldmap_mujoco_task *)held_of(&from, "task", MUJOCO);
    (void)self;
    if (task == NULL) return NULL;
    task->model = NULL;
    task->status = FIELDMAP_OK;
    Py_RETURN_NONE;
}

/* mujoco_fault(task): None, or the status of a fault, the number of the magnet, and the point in the map (3,). */
static PyObject *mujoco_fault(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap_mujoco_task *task = (const fieldmap_mujoco_task *)held_of(&from, "task", MUJOCO);
    PyObject *place;
    double *out;
    (void)self;
    if (task == NULL) return NULL;
    if (task->status == FIELDMAP_OK) Py_RETURN_NONE;
    place = new_array(1, 3, 0, &out);
    if (place == NULL) return NULL;
    memcpy(out, task->place, sizeof task->place);
    return Py_BuildValue("(iiN)", task->status, task->at_fault, place);
}

/* mujoco_callback(): the address of the callback. */
static PyObject *mujoco_callback(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    arguments(args, given, 0);
    return !PyErr_Occurred() ? PyLong_FromUnsignedLongLong((uintptr_t)add_passive_forces) : NULL;
}

#define MUJOCO_FUNCTIONS \
    FUNCTION(mujoco_task), FUNCTION(mujoco_activate), FUNCTION(mujoco_begin), FUNCTION(mujoco_fault), \
    FUNCTION(mujoco_callback)

#endif
