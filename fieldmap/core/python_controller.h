/* python_controller.h: controllers, for Python: see fieldmap.core.controller.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_CONTROLLER_H
#define FIELDMAP_PYTHON_CONTROLLER_H

#include "controller.h"
#include "python_reader.h"

static const char *const CONTROLLER = "fieldmap.core.controller";

/* hold (states,): integers, each the index of an output or -1. */
static void read_hold(reader *from, fieldmap_controller *out)
{
    int i;
    out->hold = filled_whole_of(from, "hold", out->states);
    for (i = 0; i < out->states && !PyErr_Occurred(); i++)
        require(out->hold[i] >= -1 && out->hold[i] < out->outputs, PyExc_TypeError, "hold must be numbers of outputs or -1");
}

/* The sizes are those of A (nodes, states, states) and D (nodes, outputs, 7). */
static void read_controller(reader *from, void *out)
{
    fieldmap_controller *of = (fieldmap_controller *)out;
    reader given = attributes_of(from, value_of(from, "block"));
    const number_array A = numbers_of(&given, "A", 3, ANY), D = numbers_of(&given, "D", 3, ANY);
    const npy_intp k = D.shape[0], n = A.shape[1], m = D.shape[1];
    double nodes[3] = {0.0};
    copy_of(&given, "nodes", 1, 3, nodes);
    of->nodes = (int)k, of->states = (int)n, of->outputs = (int)m;
    of->first = nodes[0], of->step = nodes[1], of->signal = (int)nodes[2];
    require(k > 0 && D.shape[2] == FIELDMAP_SIGNALS && A.shape[2] == n && A.shape[0] == k, PyExc_TypeError,
            "A must be (nodes, states, states) and D (nodes, outputs, 7)");
    require(of->signal >= 0 && of->signal < FIELDMAP_SIGNALS, PyExc_ValueError, "nodes must be of a signal from 0 to 6");
    of->A = A.at, of->D = D.at;
    of->B = numbers_of(&given, "B", 3, k * n * FIELDMAP_SIGNALS).at;
    of->C = numbers_of(&given, "C", 3, k * m * n).at;
    of->E = numbers_of(&given, "E", 3, k * n * m).at;
    of->F = numbers_of(&given, "F", 3, k * n * m).at;
    of->lower = numbers_of(&given, "lower", 1, m).at;
    of->upper = numbers_of(&given, "upper", 1, m).at;
    read_hold(&given, of);
}

/* controller(block): of an object with A, B, C, D, E, F, lower, upper, hold and nodes: first value, step, signal. */
static PyObject *controller(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    (void)self;
    return held(&from, CONTROLLER, sizeof(fieldmap_controller), read_controller);
}

/* quiet_feedforward(controller, references (p, 3), wanted (p, m), memory (n,), feedforward (p, m)) */
static PyObject *quiet_feedforward(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 5);
    const fieldmap_controller *of = (const fieldmap_controller *)held_of(&from, "controller", CONTROLLER);
    const npy_intp m = of == NULL ? 0 : of->outputs;
    const number_array references = points_of(&from, "references");
    const double *wanted = numbers_of(&from, "wanted", 2, references.shape[0] * m).at;
    double *memory = filled_of(&from, "memory", of == NULL ? 0 : of->states);
    double *feedforward = filled_of(&from, "feedforward", references.shape[0] * m);
    double *scratch = of == NULL ? NULL : (double *)memory_of(&from, (size_t)fieldmap_controller_scratch(of) * sizeof(double));
    npy_intp p;
    (void)self;
    for (p = 0; scratch != NULL && p < references.shape[0]; p++)
        fieldmap_quiet_feedforward(of, references.at + 3 * p, wanted + p * m, memory, scratch, feedforward + p * m);
    return nothing(&from);
}

/* control(controller, signals (p, 7), feedforward (p, m) or None, memory (n,), outputs (p, m), memories (p, n) or None): sample
 * by sample; the number of samples at which a limit was active. memories: the memory after each sample. */
static PyObject *control(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 6);
    const fieldmap_controller *of = (const fieldmap_controller *)held_of(&from, "controller", CONTROLLER);
    const npy_intp n = of == NULL ? 0 : of->states, m = of == NULL ? 0 : of->outputs;
    const number_array signals = numbers_of(&from, "signals", 2, ANY);
    const npy_intp count = signals.shape[0];
    const double *ahead = numbers_or_none(&from, "feedforward", 2, count * m).at, *zeros;
    double *memory = filled_of(&from, "memory", n), *outputs = filled_of(&from, "outputs", count * m);
    double *memories = filled_or_none(&from, "memories", count * n), *scratch;
    npy_intp p;
    long limited = 0;
    (void)self;
    require(signals.shape[1] == FIELDMAP_SIGNALS, PyExc_TypeError, "signals must be (p, 7)");
    if (PyErr_Occurred()) return NULL;
    scratch = (double *)memory_of(&from, (size_t)(fieldmap_controller_scratch(of) + m) * sizeof(double));
    for (p = 0; scratch != NULL && p < count; p++) {
        zeros = scratch + fieldmap_controller_scratch(of);
        limited += fieldmap_control(of, signals.at + FIELDMAP_SIGNALS * p, ahead == NULL ? zeros : ahead + p * m, memory,
                                    scratch, outputs + p * m);
        if (memories != NULL) memcpy(memories + p * n, memory, (size_t)n * sizeof(double));
    }
    return answer(&from, PyLong_FromLong(limited));
}

#define CONTROLLER_FUNCTIONS FUNCTION(controller), FUNCTION(control), FUNCTION(quiet_feedforward)
#define CONTROLLER_CONSTANTS CONSTANT(SIGNALS)

#endif
