/* python_mujoco.h: magnets in MuJoCo, for Python: see fieldmap.core.mujoco.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_MUJOCO_H
#define FIELDMAP_PYTHON_MUJOCO_H

#include "mujoco.h"
#include "python_body.h"
#include "python_map.h"

static const char *const MUJOCO = "fieldmap.core.mujoco";

/* A task, and what it uses. */
typedef struct held_task {
    fieldmap_mujoco_task task;
    fieldmap_mujoco_magnet *magnets;
    PyObject *used;
} held_task;

/* The task on which the callback works, and the capsule that holds it: MuJoCo has one callback for all. */
static fieldmap_mujoco_task *active_task = NULL;
static PyObject *active_capsule = NULL;

static void free_task(held_task *held)
{
    Py_XDECREF(held->used);
    PyMem_Free(held->magnets);
    PyMem_Free(held);
}

static void release_task(PyObject *capsule)
{
    held_task *held = (held_task *)PyCapsule_GetPointer(capsule, MUJOCO);
    if (held != NULL) free_task(held);
}

static fieldmap_mujoco_task *task_in(PyObject *capsule)
{
    held_task *held = (held_task *)PyCapsule_GetPointer(capsule, MUJOCO);
    return held == NULL ? NULL : &held->task;
}

/* What MuJoCo calls: mjfGeneric mjcb_passive. */
static void add_passive_forces(const void *model, void *data)
{
    if (active_task != NULL) fieldmap_mujoco_add_forces(active_task, model, data);
}

/* An attribute that is the address of something in another library, or an offset. */
static int address_attribute(PyObject *of, const char *name, uintptr_t *out)
{
    PyObject *given = PyObject_GetAttrString(of, name);
    if (given == NULL) return 0;
    *out = (uintptr_t)PyLong_AsUnsignedLongLong(given);
    Py_DECREF(given);
    return !PyErr_Occurred();
}

/* magnets: tuples (body, number, freedom). */
static int read_magnets(PyObject *given, held_task *held)
{
    const Py_ssize_t count = PyTuple_Check(given) ? PyTuple_Size(given) : -1;
    Py_ssize_t n;
    if (count < 0) {
        PyErr_SetString(PyExc_TypeError, "magnets must be a tuple");
        return 0;
    }
    held->magnets = (fieldmap_mujoco_magnet *)PyMem_Calloc((size_t)count + 1, sizeof *held->magnets);
    if (held->magnets == NULL) return PyErr_NoMemory() != NULL;
    for (n = 0; n < count; n++) {
        PyObject *body;
        fieldmap_mujoco_magnet *magnet = held->magnets + n;
        if (!PyArg_ParseTuple(PyTuple_GetItem(given, n), "Oii", &body, &magnet->number, &magnet->freedom)) return 0;
        magnet->body = body_in(body);
        if (magnet->body == NULL) return 0;
    }
    held->task.magnets = held->magnets;
    held->task.count = (int)count;
    return 1;
}

static int read_task(PyObject *const *args, held_task *held)
{
    fieldmap_mujoco_task *task = &held->task;
    uintptr_t apply, xpos, xmat, passive;
    const double *origin = numbers_of(args[4], 1, 3);
    task->field.map = map_in(args[0]);
    if (task->field.map == NULL) return 0;
    task->field.weights = numbers_of(args[1], 1, task->field.map->n_coils);
    if (task->field.weights == NULL || origin == NULL) {
        PyErr_SetString(PyExc_TypeError, "weights must be a float64 vector of the map's fields, and origin one of three");
        return 0;
    }
    memcpy(task->origin, origin, sizeof task->origin);
    if (!address_attribute(args[3], "apply", &apply) || !address_attribute(args[3], "xpos", &xpos)) return 0;
    if (!address_attribute(args[3], "xmat", &xmat) || !address_attribute(args[3], "passive", &passive)) return 0;
    task->apply = (fieldmap_mujoco_apply *)apply;
    task->xpos = xpos, task->xmat = xmat, task->passive = passive;
    task->mutual = PyObject_IsTrue(args[5]) == 1;
    return read_magnets(args[2], held);
}

/* mujoco_task(map, weights, magnets, layout, origin, mutual): see fieldmap.core.mujoco. */
static PyObject *mujoco_task(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_task *held;
    PyObject *capsule = NULL;
    (void)self;
    if (!has_arguments(given, 6)) return NULL;
    held = (held_task *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    /* Weights are read where they lie. */
    if (read_task(args, held) && (held->used = PyTuple_Pack(3, args[0], args[1], args[2])) != NULL)
        capsule = PyCapsule_New(held, MUJOCO, release_task);
    if (capsule == NULL) free_task(held);
    return capsule;
}

/* mujoco_activate(task or None): the task of before, or None. */
static PyObject *mujoco_activate(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    PyObject *before = active_capsule;
    fieldmap_mujoco_task *task = NULL;
    (void)self;
    if (!has_arguments(given, 1) || (args[0] != Py_None && (task = task_in(args[0])) == NULL)) return NULL;
    active_task = task;
    active_capsule = task == NULL ? NULL : args[0];
    Py_XINCREF(active_capsule);
    if (before != NULL) return before;
    Py_RETURN_NONE;
}

/* mujoco_begin(task): no fault yet, and the next call says which model it is. */
static PyObject *mujoco_begin(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_mujoco_task *task;
    (void)self;
    if (!has_arguments(given, 1) || (task = task_in(args[0])) == NULL) return NULL;
    task->model = NULL;
    task->status = FIELDMAP_OK;
    Py_RETURN_NONE;
}

/* mujoco_fault(task): None, or the number of the magnet that left the map, and where in it (3,). */
static PyObject *mujoco_fault(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    static const npy_intp three = 3;
    const fieldmap_mujoco_task *task;
    PyObject *place;
    (void)self;
    if (!has_arguments(given, 1) || (task = task_in(args[0])) == NULL) return NULL;
    if (task->status == FIELDMAP_OK) Py_RETURN_NONE;
    place = PyArray_SimpleNew(1, &three, NPY_DOUBLE);
    if (place == NULL) return NULL;
    memcpy(PyArray_DATA((PyArrayObject *)place), task->place, sizeof task->place);
    return Py_BuildValue("(iN)", task->at_fault, place);
}

/* mujoco_callback(): the address of what MuJoCo calls. */
static PyObject *mujoco_callback(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self, (void)args;
    return has_arguments(given, 0) ? PyLong_FromUnsignedLongLong((uintptr_t)add_passive_forces) : NULL;
}

#define MUJOCO_FUNCTIONS \
    FUNCTION(mujoco_task), FUNCTION(mujoco_activate), FUNCTION(mujoco_begin), FUNCTION(mujoco_fault), \
    FUNCTION(mujoco_callback)

#endif
