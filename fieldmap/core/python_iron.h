/* python_iron.h: models of saturating iron, for Python: see fieldmap.core.iron.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_IRON_H
#define FIELDMAP_PYTHON_IRON_H

#include "iron.h"
#include "python_arrays.h"

/* A model of iron and the array in which it lies; and what solves of one thread remember, in memory of its own. */
typedef struct held_iron {
    fieldmap_iron model;
    PyObject *numbers;
} held_iron;

typedef struct held_state {
    fieldmap_iron_state state;
    PyObject *iron;
    void *memory;
} held_state;

static const char *const IRON = "fieldmap.core.iron";
static const char *const STATE = "fieldmap.core.iron_state";

static void release_iron(PyObject *capsule)
{
    held_iron *held = (held_iron *)PyCapsule_GetPointer(capsule, IRON);
    if (held == NULL) return;
    Py_XDECREF(held->numbers);
    PyMem_Free(held);
}

static void release_state(PyObject *capsule)
{
    held_state *held = (held_state *)PyCapsule_GetPointer(capsule, STATE);
    if (held == NULL) return;
    Py_XDECREF(held->iron);
    PyMem_Free(held->memory);
    PyMem_Free(held);
}

static fieldmap_iron_state *state_in(PyObject *capsule)
{
    held_state *held = (held_state *)PyCapsule_GetPointer(capsule, STATE);
    return held == NULL ? NULL : &held->state;
}

/* iron_of_numbers(numbers): see fieldmap.core.iron. */
static PyObject *iron_of_numbers(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_iron *held;
    PyObject *capsule;
    const double *numbers;
    npy_intp count;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    numbers = vector_of(args[0], &count, "numbers");
    if (numbers == NULL) return NULL;
    held = (held_iron *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    if (fieldmap_iron_of_numbers(&held->model, numbers, (uint64_t)count) != FIELDMAP_OK) {
        PyMem_Free(held);
        PyErr_SetString(PyExc_ValueError, "numbers are not those of a model of iron");
        return NULL;
    }
    capsule = PyCapsule_New(held, IRON, release_iron);
    if (capsule == NULL) {
        PyMem_Free(held);
        return NULL;
    }
    Py_INCREF(args[0]);
    held->numbers = args[0];
    return capsule;
}

/* iron_state(iron) */
static PyObject *iron_state(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const held_iron *iron;
    held_state *held;
    PyObject *capsule;
    size_t size;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    iron = (const held_iron *)PyCapsule_GetPointer(args[0], IRON);
    if (iron == NULL) return NULL;
    size = fieldmap_iron_memory(&iron->model);
    held = (held_state *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    held->memory = PyMem_Malloc(size + 64);
    capsule = held->memory == NULL ? NULL : PyCapsule_New(held, STATE, release_state);
    if (capsule == NULL) {
        PyMem_Free(held->memory);
        PyMem_Free(held);
        return PyErr_Occurred() ? NULL : PyErr_NoMemory();
    }
    fieldmap_iron_start(&held->state, &iron->model, (void *)(((uintptr_t)held->memory + 63) / 64 * 64), size);
    Py_INCREF(args[0]);
    held->iron = args[0];
    return capsule;
}

/* iron_solve(state, currents, tolerance, checked, fresh, weights, slopes): the status. */
static PyObject *iron_solve(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_state *held;
    const fieldmap_iron *model;
    const double *currents;
    double *weights, *slopes = NULL;
    int status;
    (void)self;
    if (!has_arguments(given, 7)) return NULL;
    held = (held_state *)PyCapsule_GetPointer(args[0], STATE);
    if (held == NULL) return NULL;
    model = held->state.map;
    currents = numbers_of(args[1], 1, model->n_coils);
    if (currents == NULL) {
        PyErr_Format(PyExc_TypeError, "currents must be a float64 vector of %d", model->n_coils);
        return NULL;
    }
    weights = numbers_to_fill(args[5], model->n_fields, "weights");
    if (weights == NULL) return NULL;
    if (args[6] != Py_None) {
        slopes = numbers_to_fill(args[6], (npy_intp)model->n_fields * model->n_coils, "slopes");
        if (slopes == NULL) return NULL;
    }
    held->state.tolerance = PyFloat_AsDouble(args[2]);
    if (PyErr_Occurred()) return NULL;
    held->state.checked = PyObject_IsTrue(args[3]) == 1;
    if (PyObject_IsTrue(args[4]) == 1) held->state.count = 0;
    Py_BEGIN_ALLOW_THREADS
    status = slopes == NULL ? fieldmap_iron_weights(&held->state, currents, weights)
                            : fieldmap_iron_slopes(&held->state, currents, weights, slopes);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* iron_solve_in(state, applied, amplitudes, tolerance): the status; amplitudes (r,) are those to begin with, and then those
 * found. */
static PyObject *iron_solve_in(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_state *held;
    const double *applied;
    double *amplitudes, tolerance;
    int status;
    (void)self;
    if (!has_arguments(given, 4)) return NULL;
    held = (held_state *)PyCapsule_GetPointer(args[0], STATE);
    if (held == NULL) return NULL;
    applied = numbers_of(args[1], 1, 3 * (npy_intp)held->state.map->p);
    if (applied == NULL) {
        PyErr_Format(PyExc_TypeError, "applied must be a float64 vector of 3 times %d", held->state.map->p);
        return NULL;
    }
    amplitudes = numbers_to_fill(args[2], held->state.map->r, "amplitudes");
    tolerance = PyFloat_AsDouble(args[3]);
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = fieldmap_iron_solve_in(&held->state, applied, amplitudes, tolerance);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* iron_amplitudes(state): those of the last state (r,), what the solve left of it, and its steps. */
static PyObject *iron_amplitudes(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const held_state *held;
    PyObject *amplitudes;
    npy_intp modes;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    held = (const held_state *)PyCapsule_GetPointer(args[0], STATE);
    if (held == NULL) return NULL;
    modes = held->state.map->r;
    amplitudes = PyArray_SimpleNew(1, &modes, NPY_DOUBLE);
    if (amplitudes == NULL) return NULL;
    memcpy(PyArray_DATA((PyArrayObject *)amplitudes), held->state.amplitudes + (FIELDMAP_IRON_PASSED - 1) * modes,
           (size_t)modes * sizeof(double));
    return Py_BuildValue("(Ndi)", amplitudes, held->state.left_over, held->state.steps);
}

/* iron_continued(aim, passed, amplitudes): those with which a solve begins behind n states. */
static PyObject *iron_continued(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_iron model = {0};
    fieldmap_iron_state state = {0};
    npy_intp coils, modes, n = 0;
    const double *aim, *passed, *amplitudes;
    PyObject *found;
    double *room;
    (void)self;
    if (!has_arguments(given, 3) || (aim = vector_of(args[0], &coils, "aim")) == NULL) return NULL;
    if (PyArray_Check(args[2]) && PyArray_NDIM((PyArrayObject *)args[2]) == 2) n = PyArray_DIM((PyArrayObject *)args[2], 0);
    passed = numbers_of(args[1], 2, n * coils);
    modes = n > 0 ? PyArray_DIM((PyArrayObject *)args[2], 1) : 0;
    amplitudes = numbers_of(args[2], 2, n * modes);
    if (passed == NULL || amplitudes == NULL || n < 1 || n > FIELDMAP_IRON_PASSED) {
        PyErr_SetString(PyExc_TypeError, "passed (n, c) and amplitudes (n, r) must be float64 arrays of 1 to 3 states");
        return NULL;
    }
    room = (double *)PyMem_Calloc((size_t)(FIELDMAP_IRON_PASSED * (coils + modes)), sizeof(double));
    found = room == NULL ? PyErr_NoMemory() : PyArray_SimpleNew(1, &modes, NPY_DOUBLE);
    if (found != NULL) {
        model.n_coils = (int)coils, model.r = (int)modes, state.count = (int)n;
        state.currents = room, state.amplitudes = room + FIELDMAP_IRON_PASSED * coils;
        memcpy(state.currents + (FIELDMAP_IRON_PASSED - n) * coils, passed, (size_t)(n * coils) * sizeof(double));
        memcpy(state.amplitudes + (FIELDMAP_IRON_PASSED - n) * modes, amplitudes, (size_t)(n * modes) * sizeof(double));
        state.map = &model;
        fieldmap_iron_continue(&model, &state, aim, (double *)PyArray_DATA((PyArrayObject *)found));
    }
    PyMem_Free(room);
    return found;
}

#define IRON_FUNCTIONS \
    FUNCTION(iron_of_numbers), FUNCTION(iron_state), FUNCTION(iron_solve), FUNCTION(iron_solve_in), \
    FUNCTION(iron_amplitudes), FUNCTION(iron_continued)
#define IRON_CONSTANTS \
    CONSTANT(OK), CONSTANT(NOT_FINITE), CONSTANT(IRON_BEYOND), CONSTANT(IRON_NOT_CONVERGED), CONSTANT(IRON_STEPS), \
    CONSTANT(IRON_LANES), CONSTANT(IRON_SIZES)

#endif
