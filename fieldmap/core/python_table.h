/* python_table.h: tables of the weights of a map's fields, for Python: see fieldmap.core.current_table.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_TABLE_H
#define FIELDMAP_PYTHON_TABLE_H

#include "current_table.h"
#include "python_reader.h"

static const char *const TABLE = "fieldmap.core.current_table";

/* Read three vectors, each with the number of nodes of a table plus `more` numbers. */
static void read_three(reader *from, const char *name, const int *sizes, int more, const double **out)
{
    PyObject *three = value_of(from, name);
    int k;
    require(three != NULL && PyTuple_Check(three) && PyTuple_Size(three) == 3, PyExc_TypeError, "three vectors are needed");
    for (k = 0; k < 3 && !PyErr_Occurred(); k++)
        out[k] = numbers_in(PyTuple_GetItem(three, k), name, 1, sizes[k] + more).at;
}

static void read_table(reader *from, void *out)
{
    fieldmap_current_table *table = (fieldmap_current_table *)out;
    reader given = attributes_of(from, value_of(from, "numbers"));
    const number_array coefficients = numbers_of(&given, "coefficients", 4, ANY), slopes = numbers_of(&given, "slopes", 5, ANY);
    int k;
    for (k = 0; k < 3; k++) {
        require(coefficients.shape[k] >= 4 && coefficients.shape[k] < 1000000, PyExc_TypeError,
                "coefficients must have four nodes of u, x and y at least");
        table->sizes[k] = (int)coefficients.shape[k];
    }
    table->fields = (int)coefficients.shape[3], table->coefficients = coefficients.at;
    require(slopes.size == 0 || slopes.size == 6 * coefficients.size, PyExc_TypeError,
            "slopes must be (nu, nx, ny, 6, k), or empty");
    if (slopes.size > 0) table->slopes = slopes.at;
    read_three(&given, "knots", table->sizes, 4, table->knots);
    read_three(&given, "nodes", table->sizes, 0, table->nodes);
    table->exponent = real_of(&given, "exponent"), table->limit = real_of(&given, "limit");
    table->mismatch = real_of(&given, "mismatch");
    copy_of(&given, "lower", 1, 3, table->lower);
    copy_of(&given, "upper", 1, 3, table->upper);
}

/* current_table(numbers): see fieldmap.core.current_table. */
static PyObject *current_table(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    (void)self;
    return held(&from, TABLE, sizeof(fieldmap_current_table), read_table);
}

/* table_weights(table, currents, weights): their status. */
static PyObject *table_weights(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const fieldmap_current_table *table = (const fieldmap_current_table *)held_of(&from, "table", TABLE);
    const double *currents = numbers_of(&from, "currents", 1, 6).at;
    double *weights = filled_of(&from, "weights", table == NULL ? 0 : 6 + table->fields);
    (void)self;
    return PyErr_Occurred() ? NULL : PyLong_FromLong(fieldmap_table_weights(table, currents, weights));
}

/* division_signals(currents, exponent): u, x, y and the mismatch. */
static PyObject *division_signals(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    const double *currents = numbers_of(&from, "currents", 1, 6).at, exponent = real_of(&from, "exponent");
    double signals[3], mismatch;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    mismatch = fieldmap_division_signals(currents, exponent, signals);
    return Py_BuildValue("(dddd)", signals[0], signals[1], signals[2], mismatch);
}

#define TABLE_FUNCTIONS FUNCTION(current_table), FUNCTION(table_weights), FUNCTION(division_signals)
#define TABLE_CONSTANTS CONSTANT(TABLE_FOUND), CONSTANT(TABLE_BESIDE), CONSTANT(TABLE_BEYOND)

#endif
