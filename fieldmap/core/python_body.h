/* python_body.h: magnetic bodies, for Python: see fieldmap.core.body.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_BODY_H
#define FIELDMAP_PYTHON_BODY_H

#include "bodies.h"
#include "python_reader.h"

enum { BODY_PARTS = 1000000 };

static const char *const BODY = "fieldmap.core.body";

static void read_soft(reader *from, fieldmap_soft *piece)
{
    number_array law;
    copy_of(from, "centre", 1, 3, piece->centre);
    copy_of(from, "axes", 2, 9, piece->axes);
    copy_of(from, "factors", 1, 3, piece->factors);
    piece->volume = real_of(from, "volume"), piece->reluctance = real_of(from, "reluctance");
    law = numbers_of(from, "law", 2, ANY);
    require(law.shape[0] == 4 && law.shape[1] < BODY_PARTS, PyExc_TypeError, "law must be (4, knots)");
    piece->knots = (int)law.shape[1], piece->law = law.at;
}

static void read_body(reader *from, void *out)
{
    fieldmap_magnetic_body *body = (fieldmap_magnetic_body *)out;
    const number_array dipoles = numbers_of(from, "dipoles", 2, ANY);
    PyObject *pieces = value_of(from, "pieces");
    const Py_ssize_t count = pieces == NULL ? 0 : PySequence_Size(pieces);
    fieldmap_soft *soft = (fieldmap_soft *)memory_of(from, (size_t)count * sizeof(fieldmap_soft));
    Py_ssize_t p;
    require(dipoles.shape[1] == 6 && dipoles.shape[0] <= BODY_PARTS && count <= BODY_PARTS, PyExc_TypeError,
            "dipoles must be (q, 6)");
    for (p = 0; p < count && !PyErr_Occurred(); p++) {
        PyObject *piece = PySequence_GetItem(pieces, p);
        reader attributes = attributes_of(from, piece);
        read_soft(&attributes, soft + p);
        Py_XDECREF(piece);
    }
    body->n_dipoles = (int)dipoles.shape[0], body->n_soft = (int)count;
    body->dipoles = (const fieldmap_dipole *)dipoles.at, body->soft = soft;
}

/* magnetic_body(dipoles (q, 6), pieces): point and moment of each dipole; a sequence of pieces of soft iron, each with the
 * attributes centre, axes, factors, volume, reluctance and law of fieldmap_soft. */
static PyObject *magnetic_body(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 2);
    (void)self;
    return held(&from, BODY, sizeof(fieldmap_magnetic_body), read_body);
}

/* placed[count] from a tuple `bodies`, in memory of the reader. */
static fieldmap_placed *placed_of(reader *from, int *count)
{
    PyObject *bodies = value_of(from, "bodies");
    const Py_ssize_t size = bodies != NULL && PyTuple_Check(bodies) ? PyTuple_Size(bodies) : 0;
    fieldmap_placed *placed = (fieldmap_placed *)memory_of(from, (size_t)size * sizeof *placed);
    Py_ssize_t n;
    require(size > 0 && size <= BODY_PARTS, PyExc_TypeError, "bodies must be a tuple of one or more");
    for (n = 0; n < size && !PyErr_Occurred(); n++)
        placed[n].body = (const fieldmap_magnetic_body *)PyCapsule_GetPointer(PyTuple_GetItem(bodies, n), BODY);
    *count = (int)size;
    return placed;
}

/* bodies_wrench_slopes(bodies, places (n, 3), turns (n, 3, 3), weights, flux, gradient, repelled, reaction flux, reaction
 * gradient, wrench (n, 6), slopes (n, 6, k)): whether the moments of soft iron converged. */
static PyObject *bodies_wrench_slopes(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 11);
    fieldmap_bodies all = {0};
    fieldmap_placed *placed = placed_of(&from, &all.count);
    const npy_intp points = PyErr_Occurred() ? 0 : fieldmap_points_of(all.count, placed);
    const double *places = numbers_of(&from, "places", 2, 3 * all.count).at, *turns = numbers_of(&from, "turns", 3, 9 * all.count).at;
    const number_array weights = numbers_of(&from, "weights", 1, ANY);
    const double *flux = numbers_of(&from, "flux", 3, 3 * points * weights.size).at;
    const double *gradient = numbers_of(&from, "gradient", 4, 9 * points * weights.size).at;
    const long repelled = whole_of(&from, "repelled");
    const number_array reacting = numbers_of(&from, "reaction_flux", 3, ANY);
    const npy_intp fields = reacting.shape[1];
    const double *slope = numbers_of(&from, "reaction_gradient", 4, 9 * points * fields).at;
    double *wrench = filled_of(&from, "wrench", 6 * all.count), *slopes = filled_of(&from, "slopes", 6 * all.count * weights.size);
    double *room = (double *)memory_of(&from, (size_t)(6 * all.count) * sizeof(double));
    const fieldmap_acting by = {(int)weights.size, weights.at, flux, gradient};
    const fieldmap_reacting of = {(int)fields, (int)repelled, reacting.at, slope};
    int n, settled;
    (void)self;
    all.sites = (fieldmap_site *)memory_of(&from, (size_t)points * sizeof *all.sites);
    require(reacting.size == 3 * points * fields && fields <= FIELDMAP_REACTION_FIELDS, PyExc_TypeError,
            "reaction_flux must be (points, k, 3)");
    if (PyErr_Occurred()) return nothing(&from);
    for (n = 0; n < all.count; n++) {
        memcpy(placed[n].place, places + 3 * n, sizeof placed[n].place);
        memcpy(placed[n].turn, turns + 9 * n, sizeof placed[n].turn);
    }
    all.points = (int)points, all.placed = placed, all.by = by, all.of = of;
    fieldmap_place_bodies(&all);
    settled = fieldmap_bodies_wrench(&all, wrench, NULL);
    settled &= fieldmap_bodies_slopes(&all, room, slopes);
    return answer(&from, PyBool_FromLong(settled));
}

/* body_at_poses(body, turns (n, 3, 3), flux (n, q, 3), gradient, repelled, reaction flux (n, q, k, 3), reaction gradient,
 * wrench (n, 6), energies (n,), moments (n, q, 3), slopes (n, s, 3, 3)): one body at n poses; slopes, of its pieces of soft
 * iron, may be None. Returns whether all moments of soft iron converged. */
static PyObject *body_at_poses(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    static const double one = 1.0;
    reader from = arguments(args, given, 11);
    const fieldmap_magnetic_body *body = (const fieldmap_magnetic_body *)held_of(&from, "body", BODY);
    const npy_intp points = body == NULL ? 0 : fieldmap_body_points(body), pieces = body == NULL ? 0 : body->n_soft;
    const number_array turns = numbers_of(&from, "turns", 3, ANY);
    const npy_intp poses = turns.shape[0], sites = poses * points;
    const double *flux = numbers_of(&from, "flux", 3, 3 * sites).at, *gradient = numbers_of(&from, "gradient", 4, 9 * sites).at;
    const long repelled = whole_of(&from, "repelled");
    const number_array back = numbers_of(&from, "reaction_flux", 4, ANY);
    const npy_intp fields = back.shape[2];
    const double *slope = numbers_of(&from, "reaction_gradient", 5, 9 * sites * fields).at;
    double *wrench = filled_of(&from, "wrench", 6 * poses), *energies = filled_of(&from, "energies", poses);
    double *moments = filled_of(&from, "moments", 3 * sites), *slopes = filled_or_none(&from, "slopes", 9 * poses * pieces);
    fieldmap_placed placed = {body, {0.0, 0.0, 0.0}, {0.0}};
    fieldmap_bodies all = {0};
    npy_intp n, p;
    int settled = 1;
    (void)self;
    all.count = 1, all.points = (int)points, all.placed = &placed;
    all.sites = (fieldmap_site *)memory_of(&from, (size_t)points * sizeof *all.sites);
    require(turns.size == 9 * poses, PyExc_TypeError, "turns must be (n, 3, 3)");
    require(back.size == 3 * sites * fields && fields <= FIELDMAP_REACTION_FIELDS, PyExc_TypeError,
            "reaction_flux must be (n, points, k, 3)");
    if (PyErr_Occurred()) return nothing(&from);
    Py_BEGIN_ALLOW_THREADS
    for (n = 0; n < poses; n++) {
        const fieldmap_acting by = {1, &one, flux + 3 * n * points, gradient + 9 * n * points};
        const fieldmap_reacting of = {(int)fields, (int)repelled, back.at + 3 * n * points * fields, slope + 9 * n * points * fields};
        memcpy(placed.turn, turns.at + 9 * n, sizeof placed.turn);
        all.by = by, all.of = of;
        fieldmap_place_bodies(&all);
        settled &= fieldmap_bodies_wrench(&all, wrench + 6 * n, energies + n);
        for (p = 0; p < points; p++) memcpy(moments + 3 * (n * points + p), all.sites[p].moment, 3 * sizeof(double));
        for (p = 0; p < pieces && slopes != NULL; p++)
            fieldmap_site_slope(&all, all.sites + body->n_dipoles + p, slopes + 9 * (n * pieces + p));
    }
    Py_END_ALLOW_THREADS
    return answer(&from, PyBool_FromLong(settled));
}

#define BODY_FUNCTIONS \
    FUNCTION(magnetic_body), FUNCTION(bodies_wrench_slopes), FUNCTION(body_at_poses)

#endif
