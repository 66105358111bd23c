/* python_map.h: maps, for Python: see fieldmap.core.map and fieldmap.core.harmonics.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_MAP_H
#define FIELDMAP_PYTHON_MAP_H

#include "block.h"
#include "map.h"
#include "python_arrays.h"
#include "wrench.h"

/* A map and the array in which it lies. */
typedef struct held_map {
    fieldmap map;
    PyObject *block;
} held_map;

static const char *const MAP = "fieldmap.core.map";

static void release_map(PyObject *capsule)
{
    held_map *held = (held_map *)PyCapsule_GetPointer(capsule, MAP);
    if (held == NULL) return;
    Py_XDECREF(held->block);
    PyMem_Free(held);
}

static const fieldmap *map_in(PyObject *capsule)
{
    const held_map *held = (const held_map *)PyCapsule_GetPointer(capsule, MAP);
    return held == NULL ? NULL : &held->map;
}

/* Points (n, 3) and weights (n or 1, n_coils), or None for a map of one set. Raises TypeError. */
typedef struct asked {
    const fieldmap *map;
    const double *points, *weights;
    npy_intp count;
    size_t step;
} asked;

static int read_asked(PyObject *const *args, asked *found)
{
    PyArrayObject *weights = (PyArrayObject *)args[2];
    npy_intp rows, coils;
    found->map = map_in(args[0]);
    if (found->map == NULL) return 0;
    found->points = points_of(args[1], &found->count);
    found->weights = NULL;
    found->step = 0;
    coils = found->map->n_coils;
    if (args[2] != Py_None) {
        rows = PyArray_Check(args[2]) && PyArray_NDIM(weights) == 2 ? PyArray_DIM(weights, 0) : 0;
        found->weights = rows == 1 || rows == found->count ? numbers_of(args[2], 2, rows * coils) : NULL;
        found->step = rows > 1 ? (size_t)coils : 0;
    }
    if (found->points == NULL || (found->weights == NULL && (args[2] != Py_None || fieldmap_sets(found->map) != 1))) {
        PyErr_Format(PyExc_TypeError, "points and weights must be float64 arrays in C order, (n, 3) and (n or 1, %zd)",
                     (Py_ssize_t)coils);
        return 0;
    }
    return 1;
}

/* map_of_block(block, components, constant): see fieldmap.core.map. */
static PyObject *map_of_block(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_map *held;
    PyObject *capsule;
    npy_intp count;
    double *numbers;
    int status;
    (void)self;
    if (!has_arguments(given, 3)) return NULL;
    numbers = vector_of(args[0], &count, "block");
    if (numbers == NULL) return NULL;
    held = (held_map *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    status = fieldmap_of_block(&held->map, numbers, (uint64_t)count, (int)PyLong_AsLong(args[1]));
    held->map.constant = PyObject_IsTrue(args[2]) == 1;
    held->map.n_coils -= held->map.constant;
    if (status != FIELDMAP_OK) {
        PyMem_Free(held);
        PyErr_SetString(PyExc_ValueError, "block is not that of a map");
        return NULL;
    }
    capsule = PyCapsule_New(held, MAP, release_map);
    if (capsule == NULL) {
        PyMem_Free(held);
        return NULL;
    }
    Py_INCREF(args[0]);
    held->block = args[0];
    return capsule;
}

/* map_sets(map): how many sets of coefficients. */
static PyObject *map_sets(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap *map;
    (void)self;
    if (!has_arguments(given, 1) || (map = map_in(args[0])) == NULL) return NULL;
    return PyLong_FromLong(fieldmap_sets(map));
}

/* fields(map, points, weights, flux, gradient): see fieldmap.core.map. */
static PyObject *fields(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    asked of;
    double *flux, *gradient = NULL;
    size_t outside;
    (void)self;
    if (!has_arguments(given, 5) || !read_asked(args, &of)) return NULL;
    flux = numbers_to_fill(args[3], 3 * of.count, "flux");
    if (flux == NULL) return NULL;
    if (args[4] != Py_None && (gradient = numbers_to_fill(args[4], 9 * of.count, "gradient")) == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    outside = fieldmap_fields(of.map, of.weights, of.step, of.points, (size_t)of.count, flux, gradient);
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* second_gradients(map, points, weights, second) */
static PyObject *second_gradients(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    asked of;
    double *second;
    size_t outside = 0, p;
    (void)self;
    if (!has_arguments(given, 4) || !read_asked(args, &of)) return NULL;
    second = numbers_to_fill(args[3], 27 * of.count, "second");
    if (second == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (p = 0; p < (size_t)of.count; p++) {
        const double *weights = of.weights == NULL ? NULL : of.weights + p * of.step;
        outside += fieldmap_second_gradient_of_weights(of.map, weights, of.points + 3 * p, second + 27 * p)
            == FIELDMAP_OUTSIDE;
    }
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* potentials(map, points, weights, values) */
static PyObject *potentials(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    asked of;
    double *values;
    size_t outside = 0, p;
    (void)self;
    if (!has_arguments(given, 4) || !read_asked(args, &of)) return NULL;
    values = numbers_to_fill(args[3], of.count, "values");
    if (values == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (p = 0; p < (size_t)of.count; p++) {
        const double *weights = of.weights == NULL ? NULL : of.weights + p * of.step;
        outside += fieldmap_potential_of_weights(of.map, weights, of.points + 3 * p, values + p) == FIELDMAP_OUTSIDE;
    }
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* each_field(map, points, flux, gradient) */
static PyObject *each_field(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap *map;
    double *flux, *gradient = NULL;
    const double *points;
    npy_intp count, sets;
    size_t outside = 0, p;
    (void)self;
    if (!has_arguments(given, 4) || (map = map_in(args[0])) == NULL) return NULL;
    points = points_of(args[1], &count);
    sets = fieldmap_sets(map);
    if (points == NULL) {
        PyErr_SetString(PyExc_TypeError, "points must be a float64 array (n, 3) in C order");
        return NULL;
    }
    flux = numbers_to_fill(args[2], 3 * sets * count, "flux");
    if (flux == NULL) return NULL;
    if (args[3] != Py_None && (gradient = numbers_to_fill(args[3], 9 * sets * count, "gradient")) == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (p = 0; p < (size_t)count; p++) {
        double *slope = gradient == NULL ? NULL : gradient + 9 * (size_t)sets * p;
        outside += fieldmap_each_field(map, points + 3 * p, flux + 3 * (size_t)sets * p, slope) == FIELDMAP_OUTSIDE;
    }
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* sum_sets(map, weights, out) */
static PyObject *sum_sets(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap *map;
    const double *weights;
    double *out;
    size_t places = 1, n, size, sets;
    int axis;
    (void)self;
    if (!has_arguments(given, 3) || (map = map_in(args[0])) == NULL) return NULL;
    size = (size_t)map->size, sets = (size_t)fieldmap_sets(map);
    for (axis = 0; axis < 3; axis++) places *= (size_t)(map->cells[axis] + (map->kind == FIELDMAP_HERMITE));
    weights = numbers_of(args[1], 1, map->n_coils);
    if (weights == NULL) {
        PyErr_Format(PyExc_TypeError, "weights must be a float64 vector of %d", map->n_coils);
        return NULL;
    }
    out = numbers_to_fill(args[2], (npy_intp)(places * size), "out");
    if (out == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < places; n++)
        fieldmap_sum_sets(map, map->coefficients + n * sets * size, weights, out + n * size);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

/* Weights of a single point; None for a map of one set. fit: whether they fit. */
static const double *weights_at_point(const fieldmap *map, PyObject *given, int *fit)
{
    const double *weights = given == Py_None ? NULL : numbers_of(given, 1, map->n_coils);
    *fit = weights != NULL || (given == Py_None && fieldmap_sets(map) == 1);
    return weights;
}

/* field_at(map, point, weights): (B (3,), gradient (3, 3)), or None. */
static PyObject *field_at(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    static const npy_intp shape[2] = {3, 3};
    const double *point, *weights;
    const fieldmap *map;
    fieldmap_spot spot;
    PyObject *flux, *gradient, *both;
    int fits;
    (void)self;
    if (!has_arguments(given, 3) || (map = map_in(args[0])) == NULL) return NULL;
    point = numbers_of(args[1], 1, 3);
    weights = weights_at_point(map, args[2], &fits);
    if (point == NULL || !fits || fieldmap_locate(map, point, &spot) != FIELDMAP_OK) Py_RETURN_NONE;
    flux = PyArray_SimpleNew(1, shape, NPY_DOUBLE);
    gradient = PyArray_SimpleNew(2, shape, NPY_DOUBLE);
    both = flux == NULL || gradient == NULL ? NULL : PyTuple_Pack(2, flux, gradient);
    if (both != NULL)
        fieldmap_field_at(map, weights, &spot, (double *)PyArray_DATA((PyArrayObject *)flux),
                          (double *)PyArray_DATA((PyArrayObject *)gradient));
    Py_XDECREF(flux);
    Py_XDECREF(gradient);
    return both;
}

/* dipole_wrench_at(map, point, moment, weights): wrench (6,), or None. */
static PyObject *dipole_wrench_at(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    static const npy_intp six = 6;
    double flux[3], gradient[9];
    const double *point, *moment, *weights;
    const fieldmap *map;
    PyObject *wrench;
    int fits;
    (void)self;
    if (!has_arguments(given, 4) || (map = map_in(args[0])) == NULL) return NULL;
    point = numbers_of(args[1], 1, 3);
    moment = numbers_of(args[2], 1, 3);
    weights = weights_at_point(map, args[3], &fits);
    if (point == NULL || moment == NULL || !fits) Py_RETURN_NONE;
    if (fieldmap_field_of_weights(map, weights, point, flux, gradient) != FIELDMAP_OK) Py_RETURN_NONE;
    wrench = PyArray_SimpleNew(1, &six, NPY_DOUBLE);
    if (wrench != NULL)
        fieldmap_dipole_wrench(flux, gradient, moment, (double *)PyArray_DATA((PyArrayObject *)wrench));
    return wrench;
}

/* harmonics(degree, points): (n, (degree + 1)^2) regular solid harmonics at points (n, 3). */
static PyObject *harmonics(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    PyObject *table;
    const double *points;
    npy_intp shape[2], p;
    long degree;
    double *out;
    (void)self;
    if (!has_arguments(given, 2)) return NULL;
    degree = PyLong_AsLong(args[0]);
    if (PyErr_Occurred()) return NULL;
    points = points_of(args[1], shape);
    if (points == NULL || degree < 0) {
        PyErr_SetString(PyExc_TypeError, "a degree and a float64 array of points (n, 3) in C order are needed");
        return NULL;
    }
    shape[1] = (degree + 1) * (degree + 1);
    table = PyArray_SimpleNew(2, shape, NPY_DOUBLE);
    if (table == NULL) return NULL;
    out = (double *)PyArray_DATA((PyArrayObject *)table);
    for (p = 0; p < shape[0]; p++)
        fieldmap_harmonics((int)degree, 1, points + 3 * p, points + 3 * p + 1, points + 3 * p + 2, out + p * shape[1]);
    return table;
}

/* derivative_matrix(degree, axis): (degree^2, (degree + 1)^2), from coefficients to those of the derivative. */
static PyObject *derivative_matrix(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    PyObject *matrix;
    npy_intp shape[2], i, k;
    long degree, axis;
    double *out, *unit, *column;
    (void)self;
    if (!has_arguments(given, 2)) return NULL;
    degree = PyLong_AsLong(args[0]);
    axis = PyLong_AsLong(args[1]);
    if (PyErr_Occurred()) return NULL;
    if (degree < 1 || axis < 0 || axis > 2) {
        PyErr_SetString(PyExc_ValueError, "degree must be 1 or more, and axis 0, 1 or 2");
        return NULL;
    }
    shape[0] = degree * degree, shape[1] = (degree + 1) * (degree + 1);
    matrix = PyArray_SimpleNew(2, shape, NPY_DOUBLE);
    unit = (double *)PyMem_Calloc((size_t)(shape[0] + shape[1]), sizeof(double));
    if (matrix == NULL || unit == NULL) {
        Py_XDECREF(matrix);
        PyMem_Free(unit);
        return PyErr_NoMemory();
    }
    column = unit + shape[1];
    out = (double *)PyArray_DATA((PyArrayObject *)matrix);
    for (i = 0; i < shape[1]; i++) {
        unit[i] = 1.0;
        fieldmap_differentiate(unit, (int)degree, (int)axis, column);
        for (k = 0; k < shape[0]; k++) out[k * shape[1] + i] = column[k];
        unit[i] = 0.0;
    }
    PyMem_Free(unit);
    return matrix;
}

#define MAP_FUNCTIONS \
    FUNCTION(map_of_block), FUNCTION(map_sets), FUNCTION(fields), FUNCTION(second_gradients), FUNCTION(potentials), FUNCTION(each_field), \
    FUNCTION(sum_sets), FUNCTION(field_at), FUNCTION(dipole_wrench_at), FUNCTION(harmonics), FUNCTION(derivative_matrix)

#define MAP_CONSTANTS \
    CONSTANT(KIND), CONSTANT(CLAMPS), CONSTANT(SETS), CONSTANT(DEGREE), CONSTANT(LOWER), CONSTANT(INVERSE), CONSTANT(CELLS), \
    CONSTANT(LOCAL), CONSTANT(LENGTH), CONSTANT(PER_LENGTH), CONSTANT(HEADER), CONSTANT(HERMITE), CONSTANT(HARMONIC), \
    CONSTANT(GLOBAL), CONSTANT(NODE)

#endif
