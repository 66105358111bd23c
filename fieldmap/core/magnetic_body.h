/* magnetic_body.h: force and torque on a rigid body of dipoles and soft iron (docs/theory/wrench.md).
 *
 *     F_k = sum m_i dB_i/dx_k,   T = sum m x B + r x F,   r from the origin of the body
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MAGNETIC_BODY_H
#define FIELDMAP_MAGNETIC_BODY_H

#include <math.h>
#include <string.h>

#include "path.h"
#include "reaction.h"
#include "soft_iron.h"

/* T m/A: fieldmap.kernels.constants. */
#define FIELDMAP_MU0 1.25663706127e-6
#define FIELDMAP_MU0_OVER_4PI (FIELDMAP_MU0 / (4.0 * 3.14159265358979323846))

/* A dipole of fixed moment, A m^2, at a point, m; frame of the body. */
typedef struct fieldmap_dipole {
    double point[3], moment[3];
} fieldmap_dipole;

typedef struct fieldmap_magnetic_body {
    int n_dipoles, n_soft;
    const fieldmap_dipole *dipoles;
    const fieldmap_soft *soft;
} fieldmap_magnetic_body;

/* Number of points at which the field acts on a body: its dipoles, then its pieces of soft iron. */
static inline int fieldmap_body_points(const fieldmap_magnetic_body *body)
{
    return body->n_dipoles + body->n_soft;
}

/* Fill arm[3]: from the origin of a body with rotation r[9] to point p, frame of the map. */
FIELDMAP_INLINE void fieldmap_body_arm(const fieldmap_magnetic_body *body, int p, const double *r, double *arm)
{
    fieldmap_to_map(r, p < body->n_dipoles ? body->dipoles[p].point : body->soft[p - body->n_dipoles].centre, arm);
}

/* Fill moment[3] of point p in flux[3], frame of the map. Returns the energy, J: -m . B of a dipole, -integral of m dB of soft
 * iron. */
FIELDMAP_INLINE double fieldmap_body_moment(
    const fieldmap_magnetic_body *body, int p, const double *r, const double *flux, double *moment)
{
    double inside[3], induced[3], energy;
    if (p < body->n_dipoles) {
        fieldmap_to_map(r, body->dipoles[p].moment, moment);
        return -fieldmap_dot(moment, flux);
    }
    fieldmap_to_body(r, flux, inside);
    energy = fieldmap_induced_moment(body->soft + (p - body->n_dipoles), inside, induced);
    fieldmap_to_map(r, induced, moment);
    return energy;
}

/* Add the wrench of a field on a moment at an arm from the origin to wrench[6]. */
FIELDMAP_INLINE void fieldmap_add_wrench(
    const double *flux, const double *gradient, const double *moment, const double *arm, double *wrench)
{
    double own[6];
    int k;
    fieldmap_dipole_wrench(flux, gradient, moment, own);
    fieldmap_add_cross(arm, own, own + 3);
    for (k = 0; k < 6; k++) wrench[k] += own[k];
}

/* Largest number of fixed-point steps for soft iron in its own reaction, which is weak, so that each step gains digits. */
enum { FIELDMAP_REACTION_STEPS = 40 };

/* Fill flux[3], T, and gradient[9], T/m, of a field and the reaction at point p of a body; also arm[3], and at[3], its position
 * in the map. reacting: signed weights of the reaction, or NULL for none. Returns the status of the map. */
FIELDMAP_INLINE int fieldmap_body_field(
    const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place, const double *r, int p,
    const double *reacting, double *arm, double *at, double *flux, double *gradient)
{
    int i, status;
    fieldmap_body_arm(body, p, r, arm);
    for (i = 0; i < 3; i++) at[i] = place[i] + arm[i];
    status = fieldmap_path_field(field, p, at, flux, gradient);
    if (status == FIELDMAP_OK && reacting != NULL)
        status = fieldmap_reaction_field(field->map, reacting, at, flux, gradient);
    return status;
}

/* Fill place at[3] and moment[3] of point p of a body; soft iron is in the field and the reaction, as in fieldmap_body_field.
 * The field is not evaluated for magnets, whose moments are fixed. */
FIELDMAP_INLINE int fieldmap_body_dipole(
    const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place, const double *r, int p,
    const double *reacting, double *at, double *moment)
{
    double arm[3], flux[3] = {0.0}, gradient[9];
    int i, status = FIELDMAP_OK;
    if (p < body->n_dipoles) {
        fieldmap_body_arm(body, p, r, arm);
        for (i = 0; i < 3; i++) at[i] = place[i] + arm[i];
    } else {
        status = fieldmap_body_field(field, body, place, r, p, reacting, arm, at, flux, gradient);
    }
    fieldmap_body_moment(body, p, r, flux, moment);
    return status;
}

/* Add points first to last - 1 of a body to weights[k] of the reaction; arguments as in fieldmap_body_dipole. */
static inline int fieldmap_body_reacts(
    const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place, const double *r, int first, int last,
    const double *reacting, double *weights, double *at)
{
    int p, status = FIELDMAP_OK;
    for (p = first; p < last && status == FIELDMAP_OK; p++) {
        double moment[3];
        status = fieldmap_body_dipole(field, body, place, r, p, reacting, at, moment);
        if (status == FIELDMAP_OK) status = fieldmap_reaction_add(field->map, at, moment, weights);
    }
    return status;
}

/* Replace the weights by those of the next step. Returns whether they changed by more than rounding. */
static inline int fieldmap_reacting_moved(int fields, const double *next, double *weights)
{
    double largest = 0.0, change = 0.0;
    int k;
    for (k = 0; k < fields; k++) {
        const double by = fabs(next[k] - weights[k]), size = fabs(next[k]);
        change = by > change ? by : change, largest = size > largest ? size : largest;
        weights[k] = next[k];
    }
    return change > 1e-14 * largest;
}

/* Find the signed weights of the iron's reaction to a body, in `room`. *reacting points to them, or is NULL without
 * reaction. */
static inline int fieldmap_body_reaction(
    const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place, const double *r, double *room,
    const double **reacting, double *at)
{
    const fieldmap *map = field->map;
    double fixed[FIELDMAP_REACTION_FIELDS] = {0.0}, next[FIELDMAP_REACTION_FIELDS];
    int k, step, sets, status;
    *reacting = NULL;
    if (map->reaction == NULL) return FIELDMAP_OK;
    sets = map->reacting;
    status = fieldmap_body_reacts(field, body, place, r, 0, body->n_dipoles, NULL, fixed, at);
    for (k = 0; k < sets; k++) room[k] = fixed[k];
    fieldmap_reaction_signs(map, room);
    for (step = 0; step < FIELDMAP_REACTION_STEPS && body->n_soft > 0 && status == FIELDMAP_OK; step++) {
        for (k = 0; k < sets; k++) next[k] = fixed[k];
        status = fieldmap_body_reacts(field, body, place, r, body->n_dipoles, fieldmap_body_points(body), room, next, at);
        fieldmap_reaction_signs(map, next);
        if (!fieldmap_reacting_moved(sets, next, room)) break;
    }
    *reacting = room;
    return status;
}

/* Fill wrench[6] about the origin of a body at a place with rotation r[9], all in the frame of the map. Returns the status of
 * the first point at which the field is unknown, and fills `at`, unless NULL, with this point. */
static inline int fieldmap_body_wrench(const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place,
                                       const double *r, double *wrench, double *at)
{
    const int points = fieldmap_body_points(body);
    double room[FIELDMAP_REACTION_FIELDS], point[3];
    const double *reacting;
    int p, i, status;
    for (i = 0; i < 6; i++) wrench[i] = 0.0;
    status = fieldmap_body_reaction(field, body, place, r, room, &reacting, point);
    for (p = 0; p < points && status == FIELDMAP_OK; p++) {
        double arm[3], flux[3], gradient[9], moment[3];
        status = fieldmap_body_field(field, body, place, r, p, reacting, arm, point, flux, gradient);
        if (status != FIELDMAP_OK) break;
        fieldmap_body_moment(body, p, r, flux, moment);
        fieldmap_add_wrench(flux, gradient, moment, arm, wrench);
    }
    for (i = 0; i < 3 && at != NULL && status != FIELDMAP_OK; i++) at[i] = point[i];
    return status;
}

/* Fill *energy, J, of a body in a field. Returns a status as fieldmap_body_wrench does. */
static inline int fieldmap_body_energy(const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place,
                                       const double *r, double *energy)
{
    double room[FIELDMAP_REACTION_FIELDS], weights[FIELDMAP_REACTION_FIELDS] = {0.0}, point[3];
    const double *reacting;
    int p, k, status = fieldmap_body_reaction(field, body, place, r, room, &reacting, point);
    *energy = 0.0;
    for (p = 0; p < fieldmap_body_points(body) && status == FIELDMAP_OK; p++) {
        double arm[3], flux[3], gradient[9], moment[3];
        status = fieldmap_body_field(field, body, place, r, p, reacting, arm, point, flux, gradient);
        if (status != FIELDMAP_OK) break;
        *energy += fieldmap_body_moment(body, p, r, flux, moment);
        if (reacting != NULL) status = fieldmap_reaction_add(field->map, point, moment, weights);
    }
    /* The sum counts the energy of the moments in their own reaction twice. */
    for (k = 0; reacting != NULL && k < field->map->reacting; k++) *energy += 0.5 * weights[k] * reacting[k];
    return status;
}

#endif
