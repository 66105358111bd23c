/* python_controller.h: controllers, for Python: see fieldmap.core.controller.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_CONTROLLER_H
#define FIELDMAP_PYTHON_CONTROLLER_H

#include "controller.h"
#include "python_arrays.h"

static const char *const CONTROLLER = "fieldmap.core.controller";

/* A controller, and a list of the arrays in which it lies. */
typedef struct held_controller {
    fieldmap_controller controller;
    PyObject *arrays;
} held_controller;

static void free_controller(held_controller *held)
{
    Py_XDECREF(held->arrays);
    PyMem_Free(held);
}

static void release_controller(PyObject *capsule)
{
    held_controller *held = (held_controller *)PyCapsule_GetPointer(capsule, CONTROLLER);
    if (held != NULL) free_controller(held);
}

static const fieldmap_controller *controller_in(PyObject *capsule)
{
    const held_controller *held = (const held_controller *)PyCapsule_GetPointer(capsule, CONTROLLER);
    return held == NULL ? NULL : &held->controller;
}

/* Read the sizes from D (nodes, outputs, 7) and A (nodes, states, states). */
static int read_sizes(PyObject *given, fieldmap_controller *out)
{
    PyArrayObject *A = array_attribute(given, "A", 3), *D = A == NULL ? NULL : array_attribute(given, "D", 3);
    int sound = D != NULL;
    if (sound) {
        out->nodes = (int)PyArray_DIM(D, 0), out->outputs = (int)PyArray_DIM(D, 1), out->states = (int)PyArray_DIM(A, 1);
        sound = out->nodes > 0 && PyArray_DIM(D, 2) == FIELDMAP_SIGNALS && PyArray_DIM(A, 2) == out->states
            && PyArray_DIM(A, 0) == out->nodes;
        if (!sound) PyErr_SetString(PyExc_TypeError, "A must be (nodes, states, states) and D (nodes, outputs, 7)");
    }
    Py_XDECREF((PyObject *)A);
    Py_XDECREF((PyObject *)D);
    return sound;
}

/* hold (states,): whole numbers, each the number of an output or -1. */
static int read_hold(PyObject *given, fieldmap_controller *out, PyObject *arrays)
{
    PyArrayObject *array = (PyArrayObject *)PyObject_GetAttrString(given, "hold");
    int sound, i;
    if (array == NULL) return 0;
    sound = PyArray_Check((PyObject *)array) && PyArray_TYPE(array) == NPY_INT64 && PyArray_ISCARRAY_RO(array)
        && PyArray_SIZE(array) == out->states;
    if (sound) out->hold = (const int64_t *)PyArray_DATA(array);
    for (i = 0; i < out->states && sound; i++) sound = out->hold[i] >= -1 && out->hold[i] < out->outputs;
    if (!sound) PyErr_SetString(PyExc_TypeError, "hold must be int64 (states,), each the number of an output or -1");
    sound = sound && PyList_Append(arrays, (PyObject *)array) == 0;
    Py_DECREF((PyObject *)array);
    return sound;
}

static int read_controller(PyObject *given, fieldmap_controller *out, PyObject *arrays)
{
    npy_intp k, n, m;
    double nodes[3];
    if (!read_sizes(given, out) || !numbers_attribute(given, "nodes", 1, 3, nodes)) return 0;
    k = out->nodes, n = out->states, m = out->outputs;
    out->first = nodes[0], out->step = nodes[1], out->signal = (int)nodes[2];
    if (out->signal < 0 || out->signal >= FIELDMAP_SIGNALS) {
        PyErr_SetString(PyExc_ValueError, "nodes must be of a signal from 0 to 6");
        return 0;
    }
    return (out->A = kept_attribute(given, "A", 3, k * n * n, arrays)) != NULL
        && (out->B = kept_attribute(given, "B", 3, k * n * FIELDMAP_SIGNALS, arrays)) != NULL
        && (out->C = kept_attribute(given, "C", 3, k * m * n, arrays)) != NULL
        && (out->D = kept_attribute(given, "D", 3, k * m * FIELDMAP_SIGNALS, arrays)) != NULL
        && (out->E = kept_attribute(given, "E", 3, k * n * m, arrays)) != NULL
        && (out->F = kept_attribute(given, "F", 3, k * n * m, arrays)) != NULL
        && (out->lower = kept_attribute(given, "lower", 1, m, arrays)) != NULL
        && (out->upper = kept_attribute(given, "upper", 1, m, arrays)) != NULL && read_hold(given, out, arrays);
}

/* controller(block): of an object with A, B, C, D, E, F, lower, upper, hold and nodes: first value, step, signal. */
static PyObject *controller(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_controller *held;
    PyObject *capsule = NULL;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    held = (held_controller *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    held->arrays = PyList_New(0);
    if (held->arrays != NULL && read_controller(args[0], &held->controller, held->arrays))
        capsule = PyCapsule_New(held, CONTROLLER, release_controller);
    if (capsule == NULL) free_controller(held);
    return capsule;
}

/* quiet_feedforward(controller, references (p, 3), wanted (p, m), memory (n,), feedforward (p, m)) */
static PyObject *quiet_feedforward(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_controller *of;
    const double *references, *wanted;
    double *memory, *feedforward, *scratch;
    npy_intp count, p;
    (void)self;
    if (!has_arguments(given, 5) || (of = controller_in(args[0])) == NULL) return NULL;
    references = points_of(args[1], &count);
    wanted = numbers_of(args[2], 2, count * of->outputs);
    if (references == NULL || wanted == NULL) {
        PyErr_SetString(PyExc_TypeError, "references (p, 3) and wanted (p, outputs) must be float64 arrays in C order");
        return NULL;
    }
    memory = numbers_to_fill(args[3], of->states, "memory");
    feedforward = memory == NULL ? NULL : numbers_to_fill(args[4], count * of->outputs, "feedforward");
    if (feedforward == NULL) return NULL;
    scratch = (double *)PyMem_Calloc((size_t)fieldmap_controller_scratch(of) + 1, sizeof(double));
    if (scratch == NULL) return PyErr_NoMemory();
    for (p = 0; p < count; p++)
        fieldmap_quiet_feedforward(of, references + 3 * p, wanted + p * of->outputs, memory, scratch,
                                   feedforward + p * of->outputs);
    PyMem_Free(scratch);
    Py_RETURN_NONE;
}

/* control(controller, signals (p, 7), feedforward (p, m) or None, memory (n,), outputs (p, m), memories (p, n) or None): sample
 * by sample; at how many of them a limit held an output back. memories: the memory after each. */
static PyObject *control(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_controller *of;
    const double *signals, *ahead = NULL, *nothing;
    double *memory, *outputs, *memories = NULL, *scratch;
    npy_intp count, n, m, p;
    long held = 0;
    (void)self;
    if (!has_arguments(given, 6) || (of = controller_in(args[0])) == NULL) return NULL;
    n = of->states, m = of->outputs;
    count = PyArray_Check(args[1]) ? PyArray_SIZE((PyArrayObject *)args[1]) / FIELDMAP_SIGNALS : 0;
    signals = numbers_of(args[1], 2, FIELDMAP_SIGNALS * count);
    if (args[2] != Py_None) ahead = numbers_of(args[2], 2, count * m);
    if (signals == NULL || PyArray_DIM((PyArrayObject *)args[1], 1) != FIELDMAP_SIGNALS
        || (ahead == NULL) != (args[2] == Py_None)) {
        PyErr_SetString(PyExc_TypeError, "signals (p, 7) and feedforward (p, outputs) must be float64 arrays in C order");
        return NULL;
    }
    if ((memory = numbers_to_fill(args[3], n, "memory")) == NULL) return NULL;
    if ((outputs = numbers_to_fill(args[4], count * m, "outputs")) == NULL) return NULL;
    if (args[5] != Py_None && (memories = numbers_to_fill(args[5], count * n, "memories")) == NULL) return NULL;
    scratch = (double *)PyMem_Calloc((size_t)(fieldmap_controller_scratch(of) + of->outputs) + 1, sizeof(double));
    if (scratch == NULL) return PyErr_NoMemory();
    nothing = scratch + fieldmap_controller_scratch(of);
    for (p = 0; p < count; p++) {
        const double *forward = ahead == NULL ? nothing : ahead + p * m;
        held += fieldmap_control(of, signals + FIELDMAP_SIGNALS * p, forward, memory, scratch, outputs + p * m);
        if (memories != NULL) memcpy(memories + p * n, memory, (size_t)n * sizeof(double));
    }
    PyMem_Free(scratch);
    return PyLong_FromLong(held);
}

#define CONTROLLER_FUNCTIONS FUNCTION(controller), FUNCTION(control), FUNCTION(quiet_feedforward)
#define CONTROLLER_CONSTANTS CONSTANT(SIGNALS)

#endif
