/* python_table.h: tables of the weights of a map's fields, for Python: see fieldmap.core.current_table.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_TABLE_H
#define FIELDMAP_PYTHON_TABLE_H

#include "current_table.h"
#include "python_arrays.h"

static const char *const TABLE = "fieldmap.core.current_table";

/* A table, and a list of the arrays in which it lies. */
typedef struct held_table {
    fieldmap_current_table table;
    PyObject *arrays;
} held_table;

static void free_table(held_table *held)
{
    Py_XDECREF(held->arrays);
    PyMem_Free(held);
}

static void release_table(PyObject *capsule)
{
    held_table *held = (held_table *)PyCapsule_GetPointer(capsule, TABLE);
    if (held != NULL) free_table(held);
}

static const fieldmap_current_table *table_in(PyObject *capsule)
{
    const held_table *held = (const held_table *)PyCapsule_GetPointer(capsule, TABLE);
    return held == NULL ? NULL : &held->table;
}

/* Three vectors of as many numbers as a table has nodes, and `more` each; `arrays` keeps them alive. */
static int read_three(PyObject *given, const char *name, const int *sizes, int more, const double **out, PyObject *arrays)
{
    PyObject *three = PyObject_GetAttrString(given, name);
    int k, sound = three != NULL && PyTuple_Check(three) && PyTuple_Size(three) == 3;
    for (k = 0; k < 3 && sound; k++) {
        PyObject *vector = PyTuple_GetItem(three, k);
        out[k] = numbers_of(vector, 1, sizes[k] + more);
        sound = out[k] != NULL && PyList_Append(arrays, vector) == 0;
    }
    Py_XDECREF(three);
    if (!sound && !PyErr_Occurred()) PyErr_Format(PyExc_TypeError, "%s must be three float64 vectors that fit", name);
    return sound;
}

static int read_table(PyObject *given, fieldmap_current_table *out, PyObject *arrays)
{
    PyArrayObject *coefficients = array_attribute(given, "coefficients", 4), *slopes = NULL;
    npy_intp count = 1;
    int k, sound = coefficients != NULL;
    for (k = 0; k < 3 && sound; k++) {
        sound = PyArray_DIM(coefficients, k) >= 4 && PyArray_DIM(coefficients, k) < 1000000;
        out->sizes[k] = (int)PyArray_DIM(coefficients, k);
        count *= out->sizes[k];
    }
    if (sound) {
        out->fields = (int)PyArray_DIM(coefficients, 3);
        out->coefficients = (const double *)PyArray_DATA(coefficients);
        sound = PyList_Append(arrays, (PyObject *)coefficients) == 0;
    }
    Py_XDECREF((PyObject *)coefficients);
    if (!sound) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_TypeError, "coefficients must have four nodes of u, x and y at least");
        return 0;
    }
    slopes = array_attribute(given, "slopes", 5);
    if (slopes == NULL) return 0;
    if (PyArray_SIZE(slopes) > 0) {
        out->slopes = (const double *)PyArray_DATA(slopes);
        sound = PyArray_SIZE(slopes) == 6 * count * out->fields && PyList_Append(arrays, (PyObject *)slopes) == 0;
    }
    Py_DECREF(slopes);
    if (!sound) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_TypeError, "slopes must be (nu, nx, ny, 6, k), or empty");
        return 0;
    }
    return read_three(given, "knots", out->sizes, 4, out->knots, arrays)
        && read_three(given, "nodes", out->sizes, 0, out->nodes, arrays)
        && real_attribute(given, "exponent", &out->exponent) && real_attribute(given, "limit", &out->limit)
        && real_attribute(given, "mismatch", &out->mismatch) && numbers_attribute(given, "lower", 1, 3, out->lower)
        && numbers_attribute(given, "upper", 1, 3, out->upper);
}

/* current_table(numbers): see fieldmap.core.current_table. */
static PyObject *current_table(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_table *held;
    PyObject *capsule = NULL;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    held = (held_table *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    held->arrays = PyList_New(0);
    if (held->arrays != NULL && read_table(args[0], &held->table, held->arrays))
        capsule = PyCapsule_New(held, TABLE, release_table);
    if (capsule == NULL) free_table(held);
    return capsule;
}

/* table_weights(table, currents, weights): how good they are. */
static PyObject *table_weights(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_current_table *table;
    const double *currents;
    double *weights;
    (void)self;
    if (!has_arguments(given, 3) || (table = table_in(args[0])) == NULL) return NULL;
    currents = numbers_of(args[1], 1, 6);
    if (currents == NULL) {
        PyErr_SetString(PyExc_TypeError, "currents must be a float64 vector of 6");
        return NULL;
    }
    weights = numbers_to_fill(args[2], 6 + table->fields, "weights");
    if (weights == NULL) return NULL;
    return PyLong_FromLong(fieldmap_table_weights(table, currents, weights));
}

/* division_signals(currents, exponent): u, x, y and the mismatch. */
static PyObject *division_signals(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const double *currents;
    double exponent, signals[3], mismatch;
    (void)self;
    if (!has_arguments(given, 2)) return NULL;
    currents = numbers_of(args[0], 1, 6);
    exponent = PyFloat_AsDouble(args[1]);
    if (PyErr_Occurred()) return NULL;
    if (currents == NULL) {
        PyErr_SetString(PyExc_TypeError, "currents must be a float64 vector of 6");
        return NULL;
    }
    mismatch = fieldmap_division_signals(currents, exponent, signals);
    return Py_BuildValue("(dddd)", signals[0], signals[1], signals[2], mismatch);
}

#define TABLE_FUNCTIONS FUNCTION(current_table), FUNCTION(table_weights), FUNCTION(division_signals)
#define TABLE_CONSTANTS CONSTANT(TABLE_FOUND), CONSTANT(TABLE_BESIDE), CONSTANT(TABLE_BEYOND)

#endif
