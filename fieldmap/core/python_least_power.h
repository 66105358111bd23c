/* python_least_power.h: least-power currents, for Python: see fieldmap.core.least_power.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_LEAST_POWER_H
#define FIELDMAP_PYTHON_LEAST_POWER_H

#include "least_power.h"
#include "python_reader.h"

/* least_power(matrix (m, n), demand (m,), lower, upper, weight, currents (n,), active (n,) int64): the status. */
static PyObject *least_power(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 7);
    const number_array matrix = numbers_of(&from, "matrix", 2, ANY), demand = numbers_of(&from, "demand", 1, matrix.shape[0]);
    const npy_intp coils = matrix.shape[1];
    fieldmap_power_demand of;
    double *room = NULL, *currents;
    int64_t *active;
    int *marks, status = 0;
    (void)self;
    of.rows = (int)demand.size, of.coils = (int)coils;
    of.matrix = matrix.at, of.demand = demand.at;
    of.lower = numbers_of(&from, "lower", 1, coils).at;
    of.upper = numbers_of(&from, "upper", 1, coils).at;
    of.weight = numbers_of(&from, "weight", 1, coils).at;
    currents = filled_of(&from, "currents", coils);
    active = filled_whole_of(&from, "active", coils);
    if (!PyErr_Occurred()) {
        const size_t count = fieldmap_least_power_room(of.rows, of.coils);
        room = (double *)memory_of(&from, count * sizeof(double) + fieldmap_least_power_marks(of.coils) * sizeof(int));
        marks = (int *)(void *)(room + count);
    }
    if (room != NULL) status = fieldmap_least_power(&of, room, marks, currents, active);
    return answer(&from, PyLong_FromLong(status));
}

/* non_negative_least_squares(columns, target, u): whether the method ended. columns (n, size), each of length 1. */
static PyObject *non_negative_least_squares(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const number_array columns = numbers_of(&from, "columns", 2, ANY), target = numbers_of(&from, "target", 1, columns.shape[1]);
    const size_t count = (size_t)columns.shape[0], size = (size_t)columns.shape[1], room = fieldmap_nnls_room(count, size);
    double *u = filled_of(&from, "u", columns.shape[0]);
    double *memory = (double *)memory_of(&from, room * sizeof(double) + 3 * count * sizeof(int));
    fieldmap_nnls s = {0};
    int ended = 0;
    (void)self;
    s.columns = columns.at, s.target = target.at, s.count = (int)count, s.size = (int)size;
    if (memory != NULL) {
        fieldmap_nnls_lay_out(&s, memory, (int *)(void *)(memory + room));
        ended = fieldmap_nnls_solve(&s, u);
    }
    return answer(&from, PyBool_FromLong(ended));
}

#define LEAST_POWER_FUNCTIONS FUNCTION(least_power), FUNCTION(non_negative_least_squares)
#define LEAST_POWER_CONSTANTS \
    CONSTANT(POWER_FOUND), CONSTANT(POWER_OUT_OF_RANGE), CONSTANT(POWER_BEYOND_LIMITS), CONSTANT(POWER_NO_END)

#endif
