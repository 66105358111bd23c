/* python_least_power.h: least-power currents, for Python: see fieldmap.core.least_power.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_LEAST_POWER_H
#define FIELDMAP_PYTHON_LEAST_POWER_H

#include "least_power.h"
#include "python_arrays.h"

/* Room on the stack for problems of a few coils. */
enum { POWER_ROOM = 1024, POWER_MARKS = 64 };

/* The numbers of an array of this shape, or NULL. */
static const double *matrix_of(PyObject *given, npy_intp rows, npy_intp columns)
{
    const double *numbers = numbers_of(given, 2, rows * columns);
    return numbers != NULL && PyArray_DIM((PyArrayObject *)given, 1) == columns ? numbers : NULL;
}

/* least_power(matrix, demand, lower, upper, weight, currents, active): the status. */
static PyObject *least_power(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    double small_room[POWER_ROOM], *room = small_room, *currents;
    int small_marks[POWER_MARKS], *marks = small_marks, status;
    PyArrayObject *active;
    fieldmap_power_demand of;
    npy_intp rows, coils;
    size_t numbers, count;
    (void)self;
    if (!has_arguments(given, 7)) return NULL;
    active = (PyArrayObject *)args[6];
    of.demand = vector_of(args[1], &rows, "demand");
    of.weight = of.demand == NULL ? NULL : vector_of(args[4], &coils, "weight");
    if (of.weight == NULL) return NULL;
    of.rows = (int)rows, of.coils = (int)coils;
    of.matrix = matrix_of(args[0], rows, coils);
    of.lower = numbers_of(args[2], 1, coils), of.upper = numbers_of(args[3], 1, coils);
    if (of.matrix == NULL || of.lower == NULL || of.upper == NULL || !PyArray_Check(args[6])
        || PyArray_TYPE(active) != NPY_INT64 || !PyArray_ISCARRAY(active) || PyArray_SIZE(active) != coils) {
        PyErr_SetString(PyExc_TypeError, "matrix (m, n), lower, upper (n,), float64, and active (n,), int64, do not fit");
        return NULL;
    }
    currents = numbers_to_fill(args[5], coils, "currents");
    if (currents == NULL) return NULL;
    numbers = fieldmap_least_power_room(of.rows, of.coils), count = fieldmap_least_power_marks(of.coils);
    if (numbers > POWER_ROOM || count > POWER_MARKS) {
        room = (double *)PyMem_Malloc(numbers * sizeof(double));
        marks = (int *)PyMem_Malloc(count * sizeof(int));
    }
    if (room == NULL || marks == NULL) {
        PyMem_Free(room);
        PyMem_Free(marks);
        return PyErr_NoMemory();
    }
    status = fieldmap_least_power(&of, room, marks, currents, (int64_t *)PyArray_DATA(active));
    if (room != small_room) {
        PyMem_Free(room);
        PyMem_Free(marks);
    }
    return PyLong_FromLong(status);
}

/* non_negative_least_squares(columns, target, u): whether it came to an end. columns (n, size), each of length 1. */
static PyObject *non_negative_least_squares(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_nnls s;
    npy_intp size, count;
    double *u, *room;
    int *marks, ended;
    (void)self;
    if (!has_arguments(given, 3) || (s.target = vector_of(args[1], &size, "target")) == NULL) return NULL;
    count = PyArray_Check(args[2]) ? PyArray_SIZE((PyArrayObject *)args[2]) : 0;
    u = numbers_to_fill(args[2], count, "u");
    if (u == NULL) return NULL;
    s.columns = matrix_of(args[0], count, size);
    if (s.columns == NULL) {
        PyErr_SetString(PyExc_TypeError, "columns must be a float64 array (n, size) in C order");
        return NULL;
    }
    s.count = (int)count, s.size = (int)size;
    room = (double *)PyMem_Malloc(fieldmap_nnls_room((size_t)count, (size_t)size) * sizeof(double));
    marks = (int *)PyMem_Malloc(3 * (size_t)count * sizeof(int));
    if (room == NULL || marks == NULL) {
        PyMem_Free(room);
        PyMem_Free(marks);
        return PyErr_NoMemory();
    }
    fieldmap_nnls_lay_out(&s, room, marks);
    ended = fieldmap_nnls_solve(&s, u);
    PyMem_Free(room);
    PyMem_Free(marks);
    return PyBool_FromLong(ended);
}

#define LEAST_POWER_FUNCTIONS FUNCTION(least_power), FUNCTION(non_negative_least_squares)
#define LEAST_POWER_CONSTANTS \
    CONSTANT(POWER_FOUND), CONSTANT(POWER_OUT_OF_RANGE), CONSTANT(POWER_BEYOND_LIMITS), CONSTANT(POWER_NO_END)

#endif
