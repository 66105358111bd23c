/* magnetic_body.h: force and torque on a rigid body of dipoles and soft iron (docs/theory/wrench.md).
 *
 *     F_k = sum m_i dB_i/dx_k,   T = sum m x B + r x F,   r from the origin of the body
 *
 * In double precision.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MAGNETIC_BODY_H
#define FIELDMAP_MAGNETIC_BODY_H

#include "path.h"
#include "soft_iron.h"
#include "wrench.h"

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

/* At how many points the field acts on a body: its dipoles, then its pieces of soft iron. */
static inline int fieldmap_body_points(const fieldmap_magnetic_body *body)
{
    return body->n_dipoles + body->n_soft;
}

/* Point p of a body that is turned by r[9], from its origin, frame of the map. */
FIELDMAP_INLINE void fieldmap_body_arm(const fieldmap_magnetic_body *body, int p, const double *r, double *arm)
{
    fieldmap_to_map(r, p < body->n_dipoles ? body->dipoles[p].point : body->soft[p - body->n_dipoles].centre, arm);
}

/* moment[3] of point p in flux[3], both in the frame of the map; its energy, J: -m . B of a dipole, -integral of m dB of
 * soft iron. */
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

/* Add to wrench[6] what a field does to a moment at an arm from the origin. */
FIELDMAP_INLINE void fieldmap_add_wrench(
    const double *flux, const double *gradient, const double *moment, const double *arm, double *wrench)
{
    double own[6];
    int k;
    fieldmap_dipole_wrench(flux, gradient, moment, own);
    fieldmap_add_cross(arm, own, own + 3);
    for (k = 0; k < 6; k++) wrench[k] += own[k];
}

/* Add to flux[3] the field of a dipole `source` at r[3] from it, and to force[3] what it does to a dipole `moment` there. */
static inline void fieldmap_add_dipole(
    const double *r, const double *source, const double *moment, double *flux, double *force)
{
    const double square = fieldmap_dot(r, r), a = fieldmap_dot(source, r), b = fieldmap_dot(moment, r);
    const double scale = FIELDMAP_MU0_OVER_4PI / (square * square * sqrt(square));
    const double both = fieldmap_dot(source, moment) - 5.0 * a * b / square;
    int k;
    for (k = 0; k < 3; k++) {
        flux[k] += scale * (3.0 * a * r[k] - square * source[k]);
        force[k] += 3.0 * scale * (a * moment[k] + b * source[k] + both * r[k]);
    }
}

/* wrench[6] on a body at a place, turned by r[9], about its origin, all in the frame of the map. The status of the first
 * point at which the field is not known, with that point in `at` unless NULL. */
static inline int fieldmap_body_wrench(const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place,
                                       const double *r, double *wrench, double *at)
{
    const int points = fieldmap_body_points(body);
    int p, i;
    for (i = 0; i < 6; i++) wrench[i] = 0.0;
    for (p = 0; p < points; p++) {
        double arm[3], point[3], flux[3], gradient[9], moment[3];
        int status;
        fieldmap_body_arm(body, p, r, arm);
        for (i = 0; i < 3; i++) point[i] = place[i] + arm[i];
        status = fieldmap_path_field(field, p, point, flux, gradient);
        if (status != FIELDMAP_OK) {
            for (i = 0; i < 3 && at != NULL; i++) at[i] = point[i];
            return status;
        }
        fieldmap_body_moment(body, p, r, flux, moment);
        fieldmap_add_wrench(flux, gradient, moment, arm, wrench);
    }
    return FIELDMAP_OK;
}

/* *energy, J, of a body in a field; a status as above. */
static inline int fieldmap_body_energy(const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place,
                                       const double *r, double *energy)
{
    int p, i;
    *energy = 0.0;
    for (p = 0; p < fieldmap_body_points(body); p++) {
        double arm[3], point[3], flux[3], gradient[9], moment[3];
        int status;
        fieldmap_body_arm(body, p, r, arm);
        for (i = 0; i < 3; i++) point[i] = place[i] + arm[i];
        status = fieldmap_path_field(field, p, point, flux, gradient);
        if (status != FIELDMAP_OK) return status;
        *energy += fieldmap_body_moment(body, p, r, flux, moment);
    }
    return FIELDMAP_OK;
}

/* wrench[6] about the origin, and slopes[6 * fields], its derivatives by the weights of `fields` fields. flux[(p * fields +
 * k) * 3], gradient[(p * fields + k) * 9]: of field k at weight 1, at point p of the body. A soft piece's moment follows the
 * weights, dm/dw = (dm/dB) dB/dw. */
static inline void fieldmap_body_wrench_slopes(const fieldmap_magnetic_body *body, const double *r, int fields,
                                               const double *weights, const double *flux, const double *gradient,
                                               double *wrench, double *slopes)
{
    int p, i, k;
    for (i = 0; i < 6; i++) wrench[i] = 0.0;
    for (i = 0; i < 6 * fields; i++) slopes[i] = 0.0;
    for (p = 0; p < fieldmap_body_points(body); p++) {
        const double *each = flux + (size_t)p * (size_t)fields * 3, *slope = gradient + (size_t)p * (size_t)fields * 9;
        const int soft = p >= body->n_dipoles;
        double arm[3], b[3] = {0.0}, g[9] = {0.0}, moment[3], by_field[9];
        for (k = 0; k < fields; k++) {
            for (i = 0; i < 3; i++) b[i] += weights[k] * each[3 * k + i];
            for (i = 0; i < 9; i++) g[i] += weights[k] * slope[9 * k + i];
        }
        fieldmap_body_arm(body, p, r, arm);
        fieldmap_body_moment(body, p, r, b, moment);
        fieldmap_add_wrench(b, g, moment, arm, wrench);
        if (soft) {
            double inside[3], own[9];
            fieldmap_to_body(r, b, inside);
            fieldmap_moment_slope(body->soft + (p - body->n_dipoles), inside, own);
            fieldmap_turned_matrix(r, own, by_field);
        }
        for (k = 0; k < fields; k++) {
            double by_weight[6] = {0.0}, change[3];
            fieldmap_add_wrench(each + 3 * k, slope + 9 * k, moment, arm, by_weight);
            if (soft) {
                fieldmap_to_map(by_field, each + 3 * k, change);
                fieldmap_add_wrench(b, g, change, arm, by_weight);
            }
            for (i = 0; i < 6; i++) slopes[i * fields + k] += by_weight[i];
        }
    }
}

#endif
