/* python_map.h: maps, for Python: see fieldmap.core.map and fieldmap.core.harmonics.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_MAP_H
#define FIELDMAP_PYTHON_MAP_H

#include "block.h"
#include "python_reader.h"
#include "reaction.h"

static const char *const MAP = "fieldmap.core.map";

static void read_map(reader *from, void *out)
{
    fieldmap *map = (fieldmap *)out;
    const number_array block = numbers_of(from, "block", 1, ANY);
    const int components = (int)whole_of(from, "components"), constant = truth_of(from, "constant");
    if (PyErr_Occurred()) return;
    require(fieldmap_of_block(map, block.at, (uint64_t)block.size, components) == FIELDMAP_OK, PyExc_ValueError,
            "block is not that of a map");
    map->constant = constant, map->n_coils -= constant;
}

static void read_reacting(reader *from, void *out)
{
    fieldmap *map = (fieldmap *)out, own;
    const fieldmap *of = (const fieldmap *)held_of(from, "map", MAP);
    const number_array block = numbers_of(from, "block", 1, ANY);
    const long repelled = whole_of(from, "repelled");
    if (PyErr_Occurred()) return;
    require(fieldmap_of_block(&own, block.at, (uint64_t)block.size, 3) == FIELDMAP_OK && own.kind == of->kind
                && own.size == of->size && memcmp(own.cells, of->cells, sizeof own.cells) == 0,
            PyExc_ValueError, "block is not that of a reaction in this map");
    require(own.n_coils <= FIELDMAP_REACTION_FIELDS && repelled >= 0 && repelled <= own.n_coils, PyExc_ValueError,
            "block has too many fields");
    *map = *of;
    map->reaction = own.coefficients, map->reacting = own.n_coils, map->repelled = (int)repelled;
}

/* reacting_map(map, block, repelled): the map with the iron's reaction to magnets. */
static PyObject *reacting_map(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 3);
    (void)self;
    return held(&from, MAP, sizeof(fieldmap), read_reacting);
}

/* map_of_block(block, components, constant): see fieldmap.core.map. */
static PyObject *map_of_block(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 3);
    (void)self;
    return held(&from, MAP, sizeof(fieldmap), read_map);
}

/* map_sets(map): number of sets of coefficients. */
static PyObject *map_sets(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap *map = (const fieldmap *)held_of(&from, "map", MAP);
    (void)self;
    return map == NULL ? NULL : PyLong_FromLong(fieldmap_sets(map));
}

/* A map, points (n, 3) and weights (n or 1, n_coils), or None for a map of one set. step: distance from the weights of a point
 * to those of the next. */
typedef struct asked {
    const fieldmap *map;
    const double *points, *weights;
    npy_intp count;
    size_t step;
} asked;

static asked asked_of(reader *from)
{
    asked found = {(const fieldmap *)held_of(from, "map", MAP), NULL, NULL, 0, 0};
    const number_array points = points_of(from, "points"), weights = numbers_or_none(from, "weights", 2, ANY);
    if (PyErr_Occurred()) return found;
    require(weights.at == NULL ? fieldmap_sets(found.map) == 1
                               : (weights.shape[0] == 1 || weights.shape[0] == points.shape[0])
                && weights.shape[1] == found.map->n_coils,
            PyExc_TypeError, "weights must be (n or 1, n_coils), or None for a map of one set");
    found.points = points.at, found.weights = weights.at, found.count = points.shape[0];
    found.step = weights.shape[0] > 1 ? (size_t)found.map->n_coils : 0;
    return found;
}

/* fields(map, points, weights, flux, gradient): see fieldmap.core.map. */
static PyObject *fields(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 5);
    const asked of = asked_of(&from);
    double *flux = filled_of(&from, "flux", 3 * of.count), *gradient = filled_or_none(&from, "gradient", 9 * of.count);
    size_t outside;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    outside = fieldmap_fields(of.map, of.weights, of.step, of.points, (size_t)of.count, flux, gradient);
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* Evaluate a function at each point. Returns the number of points outside. */
static PyObject *at_points(
    PyObject *const *args, Py_ssize_t given, int size, int (*function)(const fieldmap *, const double *, const double *, double *))
{
    reader from = arguments(args, given, 4);
    const asked of = asked_of(&from);
    double *out = filled_of(&from, "out", size * of.count);
    size_t outside = 0, p;
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (p = 0; p < (size_t)of.count; p++) {
        const double *weights = of.weights == NULL ? NULL : of.weights + p * of.step;
        outside += function(of.map, weights, of.points + 3 * p, out + (size_t)size * p) == FIELDMAP_OUTSIDE;
    }
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* second_gradients(map, points, weights, second) */
static PyObject *second_gradients(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    return at_points(args, given, 27, fieldmap_second_gradient_of_weights);
}

/* potentials(map, points, weights, values) */
static PyObject *potentials(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    return at_points(args, given, 1, fieldmap_potential_of_weights);
}

/* each_field(map, points, flux, gradient) */
static PyObject *each_field(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    const fieldmap *map = (const fieldmap *)held_of(&from, "map", MAP);
    const number_array points = points_of(&from, "points");
    const npy_intp sets = map == NULL ? 0 : fieldmap_sets(map), count = points.shape[0];
    double *flux = filled_of(&from, "flux", 3 * sets * count), *gradient = filled_or_none(&from, "gradient", 9 * sets * count);
    size_t outside = 0, p;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (p = 0; p < (size_t)count; p++) {
        double *slope = gradient == NULL ? NULL : gradient + 9 * (size_t)sets * p;
        outside += fieldmap_each_field(map, points.at + 3 * p, flux + 3 * (size_t)sets * p, slope) == FIELDMAP_OUTSIDE;
    }
    Py_END_ALLOW_THREADS
    return PyLong_FromSize_t(outside);
}

/* sum_sets(map, weights, out) */
static PyObject *sum_sets(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const fieldmap *map = (const fieldmap *)held_of(&from, "map", MAP);
    const double *weights;
    double *out;
    size_t places = 1, n, size, sets;
    int axis;
    (void)self;
    if (map == NULL) return NULL;
    size = (size_t)map->size, sets = (size_t)fieldmap_sets(map);
    for (axis = 0; axis < 3; axis++) places *= (size_t)(map->cells[axis] + (map->kind == FIELDMAP_HERMITE));
    weights = numbers_of(&from, "weights", 1, map->n_coils).at;
    out = filled_of(&from, "out", (npy_intp)(places * size));
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < places; n++)
        fieldmap_sum_sets(map, map->coefficients + n * sets * size, weights, out + n * size);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

/* The numbers of a vector, or NULL without an error, for the functions of a single point. */
static const double *vector_at(PyObject *value, npy_intp size)
{
    return is_array(value, 1) && PyArray_SIZE((PyArrayObject *)value) == size ? (double *)PyArray_DATA((PyArrayObject *)value)
                                                                              : NULL;
}

/* Weights of a single point; None for a map of one set. fit: whether their number is right. */
static const double *weights_at_point(const fieldmap *map, PyObject *given, int *fit)
{
    const double *weights = given == Py_None ? NULL : vector_at(given, map->n_coils);
    *fit = weights != NULL || (given == Py_None && fieldmap_sets(map) == 1);
    return weights;
}

/* field_at(map, point, weights): (B (3,), gradient (3, 3)), or None. */
static PyObject *field_at(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const fieldmap *map = (const fieldmap *)held_of(&from, "map", MAP);
    const double *point, *weights;
    fieldmap_spot spot;
    PyObject *flux, *gradient, *both;
    double *B, *slope;
    int fits;
    (void)self;
    if (map == NULL) return NULL;
    point = vector_at(args[1], 3);
    weights = weights_at_point(map, args[2], &fits);
    if (point == NULL || !fits || fieldmap_locate(map, point, &spot) != FIELDMAP_OK) Py_RETURN_NONE;
    flux = new_array(1, 3, 0, &B);
    gradient = new_array(2, 3, 3, &slope);
    both = flux == NULL || gradient == NULL ? NULL : PyTuple_Pack(2, flux, gradient);
    if (both != NULL) fieldmap_field_at(map, weights, &spot, B, slope);
    Py_XDECREF(flux);
    Py_XDECREF(gradient);
    return both;
}

/* dipole_wrench_at(map, point, moment, weights): wrench (6,), or None. */
static PyObject *dipole_wrench_at(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    const fieldmap *map = (const fieldmap *)held_of(&from, "map", MAP);
    double found[6], *out;
    const double *point, *moment, *weights;
    PyObject *wrench;
    int fits;
    (void)self;
    if (map == NULL) return NULL;
    point = vector_at(args[1], 3);
    moment = vector_at(args[2], 3);
    weights = weights_at_point(map, args[3], &fits);
    if (point == NULL || moment == NULL || !fits) Py_RETURN_NONE;
    if (fieldmap_wrench_of_weights(map, weights, point, moment, found) != FIELDMAP_OK) Py_RETURN_NONE;
    wrench = new_array(1, 6, 0, &out);
    if (wrench != NULL) memcpy(out, found, sizeof found);
    return wrench;
}

/* harmonics(degree, points): (n, (degree + 1)^2) regular solid harmonics at points (n, 3). */
static PyObject *harmonics(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    const long degree = whole_of(&from, "degree"), terms = (degree + 1) * (degree + 1);
    const number_array points = points_of(&from, "points");
    PyObject *table;
    double *out;
    npy_intp p;
    (void)self;
    require(degree >= 0, PyExc_TypeError, "degree must be 0 or more");
    if (PyErr_Occurred()) return NULL;
    table = new_array(2, points.shape[0], terms, &out);
    for (p = 0; table != NULL && p < points.shape[0]; p++) {
        const double *point = points.at + 3 * p;
        fieldmap_harmonics((int)degree, 1, point, point + 1, point + 2, out + p * terms);
    }
    return table;
}

/* derivative_matrix(degree, axis): (degree^2, (degree + 1)^2), matrix from coefficients to coefficients of the derivative. */
static PyObject *derivative_matrix(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    const long degree = whole_of(&from, "degree"), axis = whole_of(&from, "axis");
    const npy_intp rows = degree * degree, columns = (degree + 1) * (degree + 1);
    PyObject *matrix = NULL;
    double *out, *unit, *column;
    npy_intp i, k;
    (void)self;
    require(degree >= 1 && axis >= 0 && axis <= 2, PyExc_ValueError, "degree must be 1 or more, and axis 0, 1 or 2");
    unit = (double *)memory_of(&from, (size_t)(rows + columns) * sizeof(double));
    if (unit != NULL) matrix = new_array(2, rows, columns, &out);
    for (i = 0; matrix != NULL && i < columns; i++) {
        column = unit + columns;
        unit[i] = 1.0;
        fieldmap_differentiate(unit, (int)degree, (int)axis, column);
        for (k = 0; k < rows; k++) out[k * columns + i] = column[k];
        unit[i] = 0.0;
    }
    return answer(&from, matrix);
}

#define MAP_FUNCTIONS \
    FUNCTION(map_of_block), FUNCTION(reacting_map), FUNCTION(map_sets), FUNCTION(fields), FUNCTION(second_gradients), FUNCTION(potentials), FUNCTION(each_field), \
    FUNCTION(sum_sets), FUNCTION(field_at), FUNCTION(dipole_wrench_at), FUNCTION(harmonics), FUNCTION(derivative_matrix)

#define MAP_CONSTANTS \
    CONSTANT(KIND), CONSTANT(CLAMPS), CONSTANT(SETS), CONSTANT(DEGREE), CONSTANT(LOWER), CONSTANT(INVERSE), CONSTANT(CELLS), \
    CONSTANT(LOCAL), CONSTANT(LENGTH), CONSTANT(PER_LENGTH), CONSTANT(HEADER), CONSTANT(HERMITE), CONSTANT(HARMONIC), \
    CONSTANT(GLOBAL), CONSTANT(NODE)

#endif
