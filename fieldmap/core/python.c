/* python.c: the run time as a module of Python, fieldmap.core.library.
 *
 * Arrays are float64, in C order and aligned; others, and sizes that do not fit, raise TypeError. Functions of a single
 * point answer None instead, also for points outside: their callers then ask on another way, which says what is wrong.
 * Functions of many points give back the interpreter's lock.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>
#if defined(__x86_64__) && defined(__GNUC__)
#include <cpuid.h>
#endif

#include "block.h"
#include "iron.h"
#include "iron_array.h"
#include "map.h"
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

/* The numbers of an array with `count` of them and this many dimensions, or NULL. */
static double *numbers_of(PyObject *given, int dimensions, npy_intp count)
{
    PyArrayObject *array = (PyArrayObject *)given;
    if (!PyArray_Check(given) || PyArray_NDIM(array) != dimensions || PyArray_TYPE(array) != NPY_DOUBLE) return NULL;
    if (!PyArray_IS_C_CONTIGUOUS(array) || !PyArray_ISBEHAVED_RO(array)) return NULL;
    return PyArray_SIZE(array) == count ? (double *)PyArray_DATA(array) : NULL;
}

/* The same for numbers to fill; raises TypeError. */
static double *numbers_to_fill(PyObject *given, npy_intp count, const char *name)
{
    PyArrayObject *array = (PyArrayObject *)given;
    if (PyArray_Check(given) && PyArray_TYPE(array) == NPY_DOUBLE && PyArray_ISCARRAY(array)
        && PyArray_SIZE(array) == count)
        return (double *)PyArray_DATA(array);
    PyErr_Format(PyExc_TypeError, "%s must be a writeable float64 array in C order of %zd numbers", name, (Py_ssize_t)count);
    return NULL;
}

/* The numbers of a vector, and how many; raises TypeError. */
static double *vector_of(PyObject *given, npy_intp *count, const char *name)
{
    double *numbers = NULL;
    *count = PyArray_Check(given) ? PyArray_SIZE((PyArrayObject *)given) : 0;
    if (*count > 0) numbers = numbers_of(given, 1, *count);
    if (numbers == NULL) PyErr_Format(PyExc_TypeError, "%s must be a float64 vector in C order", name);
    return numbers;
}

/* The numbers of an array (n, 3), or NULL, and n. */
static const double *points_of(PyObject *given, npy_intp *count)
{
    PyArrayObject *array = (PyArrayObject *)given;
    *count = 0;
    if (!PyArray_Check(given) || PyArray_NDIM(array) != 2 || PyArray_DIM(array, 1) != 3) return NULL;
    *count = PyArray_DIM(array, 0);
    return numbers_of(given, 2, 3 * *count);
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

static int has_arguments(Py_ssize_t given, Py_ssize_t wanted)
{
    if (given == wanted) return 1;
    PyErr_Format(PyExc_TypeError, "%zd arguments are needed, %zd were given", wanted, given);
    return 0;
}

/* is_for_newer(): whether this processor, and the system, run what is compiled for x86-64-v3. */
static PyObject *is_for_newer(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    int newer = 0;
    (void)self, (void)args, (void)given;
#if defined(__x86_64__) && defined(__GNUC__)
    {
        /* FMA, AVX and that the system saves registers; then AVX2, BMI1 and BMI2: Intel's manual, CPUID. */
        const unsigned first = 1u << 12 | 1u << 27 | 1u << 28, second = 1u << 3 | 1u << 5 | 1u << 8;
        unsigned a, b, c, d, saved = 0;
        newer = __get_cpuid(1, &a, &b, &c, &d) && (c & first) == first;
        newer = newer && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & second) == second;
        if (newer) __asm__("xgetbv" : "=a"(saved) : "c"(0) : "edx");
        newer = newer && (saved & 6u) == 6u;
    }
#endif
    return PyBool_FromLong(newer);
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

/* A model of iron and the array in which it lies; and what solves of one thread remember, in memory of its own. */
typedef struct held_iron {
    fieldmap_iron model;
    PyObject *numbers;
} held_iron;

typedef struct held_state {
    fieldmap_iron_state state;
    PyObject *iron;
    void *memory;
} held_state;

static const char *const IRON = "fieldmap.core.iron";
static const char *const STATE = "fieldmap.core.iron_state";

static void release_iron(PyObject *capsule)
{
    held_iron *held = (held_iron *)PyCapsule_GetPointer(capsule, IRON);
    if (held == NULL) return;
    Py_XDECREF(held->numbers);
    PyMem_Free(held);
}

static void release_state(PyObject *capsule)
{
    held_state *held = (held_state *)PyCapsule_GetPointer(capsule, STATE);
    if (held == NULL) return;
    Py_XDECREF(held->iron);
    PyMem_Free(held->memory);
    PyMem_Free(held);
}

/* iron_of_numbers(numbers): see fieldmap.core.iron. */
static PyObject *iron_of_numbers(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_iron *held;
    PyObject *capsule;
    const double *numbers;
    npy_intp count;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    numbers = vector_of(args[0], &count, "numbers");
    if (numbers == NULL) return NULL;
    held = (held_iron *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    if (fieldmap_iron_of_numbers(&held->model, numbers, (uint64_t)count) != FIELDMAP_OK) {
        PyMem_Free(held);
        PyErr_SetString(PyExc_ValueError, "numbers are not those of a model of iron");
        return NULL;
    }
    capsule = PyCapsule_New(held, IRON, release_iron);
    if (capsule == NULL) {
        PyMem_Free(held);
        return NULL;
    }
    Py_INCREF(args[0]);
    held->numbers = args[0];
    return capsule;
}

/* iron_state(iron) */
static PyObject *iron_state(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const held_iron *iron;
    held_state *held;
    PyObject *capsule;
    size_t size;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    iron = (const held_iron *)PyCapsule_GetPointer(args[0], IRON);
    if (iron == NULL) return NULL;
    size = fieldmap_iron_memory(&iron->model);
    held = (held_state *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    held->memory = PyMem_Malloc(size + 64);
    capsule = held->memory == NULL ? NULL : PyCapsule_New(held, STATE, release_state);
    if (capsule == NULL) {
        PyMem_Free(held->memory);
        PyMem_Free(held);
        return PyErr_Occurred() ? NULL : PyErr_NoMemory();
    }
    fieldmap_iron_start(&held->state, &iron->model, (void *)(((uintptr_t)held->memory + 63) / 64 * 64), size);
    Py_INCREF(args[0]);
    held->iron = args[0];
    return capsule;
}

/* iron_solve(state, currents, tolerance, checked, fresh, weights, slopes): the status. */
static PyObject *iron_solve(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_state *held;
    const fieldmap_iron *model;
    const double *currents;
    double *weights, *slopes = NULL;
    int status;
    (void)self;
    if (!has_arguments(given, 7)) return NULL;
    held = (held_state *)PyCapsule_GetPointer(args[0], STATE);
    if (held == NULL) return NULL;
    model = held->state.map;
    currents = numbers_of(args[1], 1, model->n_coils);
    if (currents == NULL) {
        PyErr_Format(PyExc_TypeError, "currents must be a float64 vector of %d", model->n_coils);
        return NULL;
    }
    weights = numbers_to_fill(args[5], model->n_fields, "weights");
    if (weights == NULL) return NULL;
    if (args[6] != Py_None) {
        slopes = numbers_to_fill(args[6], (npy_intp)model->n_fields * model->n_coils, "slopes");
        if (slopes == NULL) return NULL;
    }
    held->state.tolerance = PyFloat_AsDouble(args[2]);
    if (PyErr_Occurred()) return NULL;
    held->state.checked = PyObject_IsTrue(args[3]) == 1;
    if (PyObject_IsTrue(args[4]) == 1) held->state.count = 0;
    Py_BEGIN_ALLOW_THREADS
    status = slopes == NULL ? fieldmap_iron_weights(&held->state, currents, weights)
                            : fieldmap_iron_slopes(&held->state, currents, weights, slopes);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* iron_amplitudes(state): those of the last state (r,), and what the solve left of it. */
static PyObject *iron_amplitudes(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const held_state *held;
    PyObject *amplitudes, *both;
    npy_intp modes;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    held = (const held_state *)PyCapsule_GetPointer(args[0], STATE);
    if (held == NULL) return NULL;
    modes = held->state.map->r;
    amplitudes = PyArray_SimpleNew(1, &modes, NPY_DOUBLE);
    if (amplitudes == NULL) return NULL;
    memcpy(PyArray_DATA((PyArrayObject *)amplitudes), held->state.amplitudes + (FIELDMAP_IRON_PASSED - 1) * modes,
           (size_t)modes * sizeof(double));
    both = Py_BuildValue("(Nd)", amplitudes, held->state.left_over);
    return both;
}

/* iron_array_length(iron): of the array of a model (iron_array.h). */
static PyObject *iron_array_length(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const held_iron *iron;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    iron = (const held_iron *)PyCapsule_GetPointer(args[0], IRON);
    if (iron == NULL) return NULL;
    return PyLong_FromSize_t(
        fieldmap_iron_array_length(&iron->model, (size_t)PyArray_SIZE((PyArrayObject *)iron->numbers)));
}

/* iron_array_begin(array): fill in addresses, and that nothing is remembered yet. */
static PyObject *iron_array_begin(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_iron model;
    npy_intp length, count;
    double *array;
    int sound;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    length = PyArray_Check(args[0]) ? PyArray_SIZE((PyArrayObject *)args[0]) : 0;
    array = numbers_to_fill(args[0], length, "array");
    if (array == NULL) return NULL;
    /* Nothing is written before the length is what the numbers promise. */
    memset(&model, 0, sizeof model);
    count = length < FIELDMAP_ARRAY_HEAD ? -1 : (npy_intp)fieldmap_whole(array[FIELDMAP_ARRAY_COUNT], 1, (long)length);
    sound = count > 0 && count <= length - FIELDMAP_ARRAY_HEAD
        && fieldmap_iron_of_numbers(&model, array + FIELDMAP_ARRAY_HEAD, (uint64_t)count) == FIELDMAP_OK
        && fieldmap_iron_array_length(&model, (size_t)count) == (size_t)length;
    if (!sound || fieldmap_iron_array_begin(array) != FIELDMAP_OK) {
        PyErr_SetString(PyExc_ValueError, "array is not that of a model of iron");
        return NULL;
    }
    /* Addresses have 57 bits at most, of which the last are zero. */
    array[FIELDMAP_ARRAY_ADDRESS] = (double)(uintptr_t)fieldmap_iron_array_weights;
    Py_RETURN_NONE;
}

#define FUNCTION(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}

static PyMethodDef functions[] = {
    FUNCTION(is_for_newer), FUNCTION(map_of_block), FUNCTION(fields), FUNCTION(second_gradients), FUNCTION(potentials),
    FUNCTION(each_field), FUNCTION(sum_sets), FUNCTION(field_at), FUNCTION(dipole_wrench_at),
    FUNCTION(harmonics), FUNCTION(derivative_matrix), FUNCTION(iron_of_numbers), FUNCTION(iron_state), FUNCTION(iron_solve), FUNCTION(iron_amplitudes),
    FUNCTION(iron_array_length), FUNCTION(iron_array_begin), {NULL, NULL, 0, NULL}};

static int start(PyObject *module)
{
    (void)module;
    return PyArray_ImportNumPyAPI();
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)start}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "library", "The compiled run time.", 0, functions, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_library(void)
{
    return PyModuleDef_Init(&definition);
}
