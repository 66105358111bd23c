/* python_sampled_loop.h: closed loops of sampled linear plants, for Python: see fieldmap.core.sampled_loop.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_SAMPLED_LOOP_H
#define FIELDMAP_PYTHON_SAMPLED_LOOP_H

#include "python_controller.h"
#include "python_instruments.h"
#include "sampled_loop.h"

/* A plant of A (n, n), B (n,) and C (n,), whose arrays `arrays` keeps alive. */
static int read_plant(PyObject *given, fieldmap_plant *out, PyObject *arrays)
{
    PyArrayObject *B = array_attribute(given, "B", 1);
    npy_intp states;
    if (B == NULL) return 0;
    states = PyArray_SIZE(B);
    Py_DECREF(B);
    out->states = (int)states;
    return (out->A = kept_attribute(given, "A", 2, states * states, arrays)) != NULL
        && (out->B = kept_attribute(given, "B", 1, states, arrays)) != NULL
        && (out->C = kept_attribute(given, "C", 1, states, arrays)) != NULL;
}

/* chain (10,), drive (7,), position and output: the numbers of the structures, in their order. */
static int read_loop_instruments(PyObject *given, fieldmap_loop_instruments *out)
{
    return numbers_attribute(given, "chain", 1, CHAIN_NUMBERS, (double *)(void *)&out->chain)
        && numbers_attribute(given, "drive", 1, DRIVE_NUMBERS, (double *)(void *)&out->drive)
        && real_attribute(given, "position", &out->position) && real_attribute(given, "output", &out->output);
}

/* A signal of (runs or 1, samples or 1) numbers: how far it is from run to run and from sample to sample. */
typedef struct loop_signal {
    const double *numbers;
    npy_intp by_run, by_sample;
} loop_signal;

static double at_sample(const loop_signal *signal, npy_intp run, npy_intp n)
{
    return signal->numbers[run * signal->by_run + n * signal->by_sample];
}

static int read_loop_signal(
    PyObject *given, const char *name, npy_intp runs, npy_intp samples, loop_signal *out, PyObject *arrays)
{
    PyArrayObject *array = array_attribute(given, name, 2);
    npy_intp rows, columns;
    if (array == NULL) return 0;
    rows = PyArray_DIM(array, 0), columns = PyArray_DIM(array, 1);
    Py_DECREF(array);
    if ((rows != 1 && rows != runs) || (columns != 1 && columns != samples)) {
        PyErr_Format(PyExc_TypeError, "%s must be (%zd or 1, %zd or 1)", name, (Py_ssize_t)runs, (Py_ssize_t)samples);
        return 0;
    }
    out->by_run = rows > 1 ? columns : 0, out->by_sample = columns > 1;
    return (out->numbers = kept_attribute(given, name, 2, rows * columns, arrays)) != NULL;
}

typedef struct asked_loop {
    fieldmap_plant plant;
    const fieldmap_controller *controller;
    fieldmap_loop_instruments instruments;
    loop_signal reference, position_noise, voltage_noise, current_noise, disturbance;
    const double *memory;
    double *y, *u;
    npy_intp runs, samples;
} asked_loop;

static int read_loop_signals(PyObject *given, asked_loop *of, PyObject *arrays)
{
    const npy_intp runs = of->runs, samples = of->samples;
    return read_loop_signal(given, "reference", runs, samples, &of->reference, arrays)
        && read_loop_signal(given, "position_noise", runs, samples, &of->position_noise, arrays)
        && read_loop_signal(given, "voltage_noise", runs, samples, &of->voltage_noise, arrays)
        && read_loop_signal(given, "current_noise", runs, samples, &of->current_noise, arrays)
        && read_loop_signal(given, "disturbance", runs, samples, &of->disturbance, arrays);
}

static int read_sampled_loop(PyObject *const *args, asked_loop *of, PyObject *arrays)
{
    PyArrayObject *y = (PyArrayObject *)args[5];
    if (!PyArray_Check(args[5]) || PyArray_NDIM(y) != 2) {
        PyErr_SetString(PyExc_TypeError, "y must be an array (runs, samples)");
        return 0;
    }
    of->runs = PyArray_DIM(y, 0), of->samples = PyArray_DIM(y, 1);
    of->controller = controller_in(args[1]);
    if (of->controller == NULL || !read_plant(args[0], &of->plant, arrays)) return 0;
    of->memory = numbers_of(args[4], 1, of->controller->states);
    if (of->memory == NULL || of->controller->outputs != 1) {
        PyErr_SetString(PyExc_TypeError, "the controller must have one output, and memory must fit it");
        return 0;
    }
    return read_loop_instruments(args[2], &of->instruments)
        && read_loop_signals(args[3], of, arrays)
        && (of->y = numbers_to_fill(args[5], of->runs * of->samples, "y")) != NULL
        && (of->u = numbers_to_fill(args[6], of->runs * of->samples, "u")) != NULL;
}

/* A run from rest and from the given memory. work: numbers for a state, a memory and scratch. */
static void run_loop(const asked_loop *of, npy_intp run, double *work)
{
    double *x = work, *memory = x + of->plant.states, *scratch = memory + of->controller->states;
    npy_intp n;
    int i;
    for (i = 0; i < of->plant.states; i++) x[i] = 0.0;
    for (i = 0; i < of->controller->states; i++) memory[i] = of->memory[i];
    for (n = 0; n < of->samples; n++) {
        const fieldmap_loop_inputs in = {
            at_sample(&of->reference, run, n), at_sample(&of->position_noise, run, n), at_sample(&of->voltage_noise, run, n),
            at_sample(&of->current_noise, run, n), at_sample(&of->disturbance, run, n)};
        const npy_intp at = run * of->samples + n;
        of->y[at] = fieldmap_loop_sample(&of->plant, of->controller, &of->instruments, &in, x, memory, scratch, of->u + at);
    }
}

/* sampled_loop(plant, controller, instruments, signals, memory (n,), y (runs, samples), u (runs, samples)) */
static PyObject *sampled_loop(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    asked_loop of;
    PyObject *arrays, *done = NULL;
    double *work = NULL;
    (void)self;
    if (!has_arguments(given, 7)) return NULL;
    arrays = PyList_New(0);
    if (arrays != NULL && read_sampled_loop(args, &of, arrays)) {
        const int numbers = of.plant.states + of.controller->states + fieldmap_loop_scratch(&of.plant, of.controller);
        work = (double *)PyMem_Calloc((size_t)numbers, sizeof(double));
        if (work == NULL) PyErr_NoMemory();
    }
    if (work != NULL) {
        npy_intp run;
        Py_BEGIN_ALLOW_THREADS
        for (run = 0; run < of.runs; run++) run_loop(&of, run, work);
        Py_END_ALLOW_THREADS
        done = Py_NewRef(Py_None);
    }
    PyMem_Free(work);
    Py_XDECREF(arrays);
    return done;
}

#define SAMPLED_LOOP_FUNCTIONS FUNCTION(sampled_loop)

#endif
