/* python_instruments.h: instruments, for Python: see fieldmap.core.instruments.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_INSTRUMENTS_H
#define FIELDMAP_PYTHON_INSTRUMENTS_H

#include <limits.h>

#include "instruments.h"
#include "python_reader.h"

/* The structures hold only numbers; in Python they are arrays. */
enum {
    CHAIN_NUMBERS = sizeof(fieldmap_chain) / sizeof(double),
    DRIVE_NUMBERS = sizeof(fieldmap_drive) / sizeof(double)
};

/* measure_all(positions (n,), voltage_noise (n,), chain, out (n,)) */
static PyObject *measure_all(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    const number_array positions = numbers_of(&from, "positions", 1, ANY);
    const double *noise = numbers_of(&from, "voltage_noise", 1, positions.size).at;
    fieldmap_chain chain;
    double *out;
    npy_intp n;
    (void)self;
    copy_of(&from, "chain", 1, CHAIN_NUMBERS, (double *)&chain);
    out = filled_of(&from, "out", positions.size);
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < positions.size; n++) out[n] = fieldmap_measure(&chain, positions.at[n], noise[n]);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

/* drive_all(voltages (n,), current_noise (n,), drive, out (n,)) */
static PyObject *drive_all(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    const number_array voltages = numbers_of(&from, "voltages", 1, ANY);
    const double *noise = numbers_of(&from, "current_noise", 1, voltages.size).at;
    fieldmap_drive drive;
    double *out;
    npy_intp n;
    (void)self;
    copy_of(&from, "drive", 1, DRIVE_NUMBERS, (double *)&drive);
    out = filled_of(&from, "out", voltages.size);
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < voltages.size; n++) out[n] = fieldmap_driven(&drive, voltages.at[n], noise[n]);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

/* held_scans(scans (n,), averages, latency, ratio, out): sample m is taken m * ratio scan times after the start. */
static PyObject *held_scans(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 5);
    const number_array scans = numbers_of(&from, "scans", 1, ANY);
    const long averages = whole_of(&from, "averages"), latency = whole_of(&from, "latency");
    const double ratio = real_of(&from, "ratio");
    PyObject *array = value_of(&from, "out");
    const npy_intp samples = array != NULL && PyArray_Check(array) ? PyArray_SIZE((PyArrayObject *)array) : 0;
    double *out = (double *)data_to_fill(array, "out", NPY_DOUBLE, samples);
    npy_intp m;
    (void)self;
    require(scans.size > 0 && scans.size <= LONG_MAX, PyExc_TypeError, "there must be scans");
    require(averages >= 1 && averages <= INT_MAX && latency >= 0 && latency <= INT_MAX, PyExc_ValueError,
            "averages must be 1 or more, latency 0 or more");
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (m = 0; m < samples; m++)
        out[m] = fieldmap_held_scan(scans.at, (long)scans.size, 1, (double)m * ratio, (int)averages, (int)latency);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

#define INSTRUMENT_FUNCTIONS FUNCTION(measure_all), FUNCTION(drive_all), FUNCTION(held_scans)

#endif
