/* python_body.h: magnetic bodies, for Python: see fieldmap.core.body.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_BODY_H
#define FIELDMAP_PYTHON_BODY_H

#include "magnetic_body.h"
#include "python_arrays.h"

static const char *const BODY = "fieldmap.core.body";

/* A body and the memory in which its parts lie, behind it. */
typedef struct held_body {
    fieldmap_magnetic_body body;
    fieldmap_soft *soft;
    double *numbers;
} held_body;

static void free_body(held_body *held)
{
    PyMem_Free(held->numbers);
    PyMem_Free(held->soft);
    PyMem_Free(held);
}

static void release_body(PyObject *capsule)
{
    held_body *held = (held_body *)PyCapsule_GetPointer(capsule, BODY);
    if (held != NULL) free_body(held);
}

static const fieldmap_magnetic_body *body_in(PyObject *capsule)
{
    const held_body *held = (const held_body *)PyCapsule_GetPointer(capsule, BODY);
    return held == NULL ? NULL : &held->body;
}

/* Read a piece of soft iron but for its law; the number of knots of that. */
static int read_soft(PyObject *given, fieldmap_soft *piece)
{
    PyArrayObject *law;
    int sound = numbers_attribute(given, "centre", 1, 3, piece->centre)
        && numbers_attribute(given, "axes", 2, 9, piece->axes) && numbers_attribute(given, "factors", 1, 3, piece->factors)
        && real_attribute(given, "volume", &piece->volume) && real_attribute(given, "reluctance", &piece->reluctance);
    law = sound ? array_attribute(given, "law", 2) : NULL;
    if (law == NULL) return 0;
    sound = PyArray_DIM(law, 0) == 4 && PyArray_DIM(law, 1) < 1000000;
    piece->knots = (int)PyArray_DIM(law, 1);
    if (!sound) PyErr_SetString(PyExc_TypeError, "law must be (4, knots)");
    Py_DECREF((PyObject *)law);
    return sound;
}

/* Copy the laws of the pieces behind the dipoles, now that there is room. */
static int copy_laws(PyObject *pieces, held_body *held, double *to)
{
    int p;
    for (p = 0; p < held->body.n_soft; p++) {
        PyObject *piece = PySequence_GetItem(pieces, p);
        const npy_intp count = 4 * held->soft[p].knots;
        const int copied = piece != NULL && numbers_attribute(piece, "law", 2, count, to);
        Py_XDECREF(piece);
        if (!copied) return 0;
        held->soft[p].law = to;
        to += count;
    }
    return 1;
}

/* magnetic_body(dipoles (q, 6), pieces): point and moment of each dipole; a sequence of pieces of soft iron, each with
 * centre, axes, factors, volume (over mu0), reluctance and law as fieldmap_soft has them. */
static PyObject *magnetic_body(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    PyArrayObject *dipoles;
    Py_ssize_t pieces;
    PyObject *capsule = NULL;
    held_body *held;
    npy_intp count, numbers;
    int sound = 1, p;
    (void)self;
    if (!has_arguments(given, 2)) return NULL;
    dipoles = (PyArrayObject *)args[0];
    count = PyArray_Check(args[0]) ? PyArray_SIZE(dipoles) : 0;
    pieces = PySequence_Size(args[1]);
    if (pieces < 0) return NULL;
    if (numbers_of(args[0], 2, count) == NULL || PyArray_DIM(dipoles, 1) != 6 || count > 6000000 || pieces > 1000000) {
        PyErr_SetString(PyExc_TypeError, "dipoles must be a float64 array (q, 6) in C order");
        return NULL;
    }
    held = (held_body *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    held->body.n_dipoles = (int)(count / 6), held->body.n_soft = (int)pieces;
    held->soft = (fieldmap_soft *)PyMem_Calloc((size_t)pieces + 1, sizeof(fieldmap_soft));
    numbers = count;
    for (p = 0; p < pieces && sound && held->soft != NULL; p++) {
        PyObject *piece = PySequence_GetItem(args[1], p);
        sound = piece != NULL && read_soft(piece, held->soft + p);
        numbers += 4 * held->soft[p].knots;
        Py_XDECREF(piece);
    }
    held->numbers = (double *)PyMem_Calloc((size_t)numbers + 1, sizeof(double));
    if (held->soft == NULL || held->numbers == NULL) {
        PyErr_NoMemory();
    } else if (sound && copy_laws(args[1], held, held->numbers + count)) {
        memcpy(held->numbers, PyArray_DATA(dipoles), (size_t)count * sizeof(double));
        held->body.dipoles = (const fieldmap_dipole *)held->numbers;
        held->body.soft = held->soft;
        capsule = PyCapsule_New(held, BODY, release_body);
    }
    if (capsule == NULL) free_body(held);
    return capsule;
}

/* body_wrench_slopes(body, turn, weights, flux, gradient, wrench, slopes) */
static PyObject *body_wrench_slopes(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_magnetic_body *body;
    const double *turn, *weights, *flux, *gradient;
    double *wrench, *slopes;
    npy_intp fields, points;
    (void)self;
    if (!has_arguments(given, 7) || (body = body_in(args[0])) == NULL) return NULL;
    points = fieldmap_body_points(body);
    weights = vector_of(args[2], &fields, "weights");
    if (weights == NULL) return NULL;
    turn = numbers_of(args[1], 2, 9);
    flux = numbers_of(args[3], 3, 3 * points * fields);
    gradient = numbers_of(args[4], 4, 9 * points * fields);
    if (turn == NULL || flux == NULL || gradient == NULL) {
        PyErr_SetString(PyExc_TypeError, "turn (3, 3), flux (points, fields, 3) and gradient (points, fields, 3, 3) do not fit");
        return NULL;
    }
    wrench = numbers_to_fill(args[5], 6, "wrench");
    slopes = wrench == NULL ? NULL : numbers_to_fill(args[6], 6 * fields, "slopes");
    if (slopes == NULL) return NULL;
    fieldmap_body_wrench_slopes(body, turn, (int)fields, weights, flux, gradient, wrench, slopes);
    Py_RETURN_NONE;
}

/* induced_moments(body, turns, flux, moments, energies, slopes): of the soft pieces at n poses; slopes may be None. */
static PyObject *induced_moments(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_magnetic_body *body;
    const double *turns, *flux;
    double *moments, *energies, *slopes = NULL;
    npy_intp poses, pieces, n, p;
    (void)self;
    if (!has_arguments(given, 6) || (body = body_in(args[0])) == NULL) return NULL;
    pieces = body->n_soft;
    poses = PyArray_Check(args[1]) && PyArray_NDIM((PyArrayObject *)args[1]) == 3 ? PyArray_DIM((PyArrayObject *)args[1], 0) : 0;
    turns = numbers_of(args[1], 3, 9 * poses);
    flux = numbers_of(args[2], 3, 3 * poses * pieces);
    if (turns == NULL || flux == NULL) {
        PyErr_SetString(PyExc_TypeError, "turns (n, 3, 3) and flux (n, pieces, 3) must be float64 arrays in C order");
        return NULL;
    }
    moments = numbers_to_fill(args[3], 3 * poses * pieces, "moments");
    energies = moments == NULL ? NULL : numbers_to_fill(args[4], poses * pieces, "energies");
    if (energies == NULL) return NULL;
    if (args[5] != Py_None && (slopes = numbers_to_fill(args[5], 9 * poses * pieces, "slopes")) == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < poses; n++) {
        const double *r = turns + 9 * n;
        for (p = 0; p < pieces; p++) {
            const npy_intp at = n * pieces + p;
            energies[at] = fieldmap_body_moment(body, body->n_dipoles + (int)p, r, flux + 3 * at, moments + 3 * at);
            if (slopes != NULL) {
                double inside[3], own[9];
                fieldmap_to_body(r, flux + 3 * at, inside);
                fieldmap_moment_slope(body->soft + p, inside, own);
                fieldmap_turned_matrix(r, own, slopes + 9 * at);
            }
        }
    }
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

#define BODY_FUNCTIONS \
    FUNCTION(magnetic_body), FUNCTION(body_wrench_slopes), FUNCTION(induced_moments)

#endif
