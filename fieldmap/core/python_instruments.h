/* python_instruments.h: instruments, for Python: see fieldmap.core.instruments.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_INSTRUMENTS_H
#define FIELDMAP_PYTHON_INSTRUMENTS_H

#include <limits.h>

#include "instruments.h"
#include "python_arrays.h"

/* The structures hold numbers only: in Python they are arrays of them. */
enum {
    CHAIN_NUMBERS = sizeof(fieldmap_chain) / sizeof(double),
    DRIVE_NUMBERS = sizeof(fieldmap_drive) / sizeof(double)
};

/* Values and noise (n,), numbers of an instrument, and an array (n,) to fill. Raises TypeError. */
typedef struct asked_instrument {
    npy_intp count;
    const double *values, *noise, *numbers;
    double *out;
} asked_instrument;

static int read_instrument(PyObject *const *args, npy_intp numbers, asked_instrument *of)
{
    of->count = PyArray_Check(args[0]) ? PyArray_SIZE((PyArrayObject *)args[0]) : 0;
    of->values = numbers_of(args[0], 1, of->count);
    of->noise = numbers_of(args[1], 1, of->count);
    of->numbers = numbers_of(args[2], 1, numbers);
    if (of->values == NULL || of->noise == NULL || of->numbers == NULL) {
        PyErr_Format(PyExc_TypeError, "values (n,), noise (n,) and %zd numbers must be float64 vectors in C order",
                     (Py_ssize_t)numbers);
        return 0;
    }
    of->out = numbers_to_fill(args[3], of->count, "out");
    return of->out != NULL;
}

/* measure_all(positions, voltage_noise, chain, out) */
static PyObject *measure_all(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    asked_instrument of;
    fieldmap_chain chain;
    npy_intp n;
    (void)self;
    if (!has_arguments(given, 4) || !read_instrument(args, CHAIN_NUMBERS, &of)) return NULL;
    memcpy(&chain, of.numbers, sizeof chain);
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < of.count; n++) of.out[n] = fieldmap_measure(&chain, of.values[n], of.noise[n]);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

/* drive_all(voltages, current_noise, drive, out) */
static PyObject *drive_all(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    asked_instrument of;
    fieldmap_drive drive;
    npy_intp n;
    (void)self;
    if (!has_arguments(given, 4) || !read_instrument(args, DRIVE_NUMBERS, &of)) return NULL;
    memcpy(&drive, of.numbers, sizeof drive);
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < of.count; n++) of.out[n] = fieldmap_driven(&drive, of.values[n], of.noise[n]);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

/* held_scans(scans (n,), averages, latency, ratio, out): sample m is taken when m * ratio times of a scan have passed. */
static PyObject *held_scans(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    npy_intp count, samples, m;
    const double *scans;
    double *out, ratio;
    long long averages, latency;
    (void)self;
    if (!has_arguments(given, 5) || (scans = vector_of(args[0], &count, "scans")) == NULL) return NULL;
    averages = PyLong_AsLongLong(args[1]), latency = PyLong_AsLongLong(args[2]), ratio = PyFloat_AsDouble(args[3]);
    if (PyErr_Occurred()) return NULL;
    if (averages < 1 || averages > INT_MAX || latency < 0 || latency > INT_MAX || count > LONG_MAX) {
        PyErr_SetString(PyExc_ValueError, "averages must be 1 or more, latency 0 or more");
        return NULL;
    }
    samples = PyArray_Check(args[4]) ? PyArray_SIZE((PyArrayObject *)args[4]) : 0;
    out = numbers_to_fill(args[4], samples, "out");
    if (out == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (m = 0; m < samples; m++)
        out[m] = fieldmap_held_scan(scans, (long)count, 1, (double)m * ratio, (int)averages, (int)latency);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

#define INSTRUMENT_FUNCTIONS FUNCTION(measure_all), FUNCTION(drive_all), FUNCTION(held_scans)

#endif
