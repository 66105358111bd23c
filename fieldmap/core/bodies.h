/* bodies.h: force and torque on bodies that act on each other (docs/theory/reaction.md, docs/theory/wrench.md).
 *
 * Three fields act on each body: external fields, the field of the dipoles of all other bodies, and the iron's reaction to all
 * bodies. The moments of soft iron follow their sum and minimise the energy. The Gauss-Seidel method finds them: it updates one
 * moment at a time, and it converges for pieces that do not overlap.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_BODIES_H
#define FIELDMAP_BODIES_H

#include "magnetic_body.h"

/* Status: the moments do not converge, because bodies overlap. */
enum { FIELDMAP_UNSETTLED = 64 };

/* A body at a place, with rotation turn[9], frame of the map. */
typedef struct fieldmap_placed {
    const fieldmap_magnetic_body *body;
    double place[3], turn[9];
} fieldmap_placed;

/* Point `number` of body `owner`. arm: from the origin of the body; at: in the map; moment, and change: its derivative with
 * respect to a weight; flux: of all fields; gradient: without the other bodies; slope: dm/dB of soft iron. */
typedef struct fieldmap_site {
    int owner, number;
    double arm[3], at[3], moment[3], change[3], flux[3], gradient[9], slope[9];
} fieldmap_site;

/* Fields at points of bodies: flux[(p * fields + k) * 3] and gradient[(p * fields + k) * 9] of field k at weight 1. In the
 * iron's reaction the last `repelled` fields have the sign -1. */
typedef struct fieldmap_acting {
    int fields;
    const double *weights, *flux, *gradient;
} fieldmap_acting;

typedef struct fieldmap_reacting {
    int fields, repelled;
    const double *flux, *gradient;
} fieldmap_reacting;

/* sites: one for each point, one body after the other; by: external fields; of: the reaction, with the weights w_k. */
typedef struct fieldmap_bodies {
    int count, points;
    const fieldmap_placed *placed;
    fieldmap_site *sites;
    fieldmap_acting by;
    fieldmap_reacting of;
    double weights[FIELDMAP_REACTION_FIELDS];
} fieldmap_bodies;

/* Number of points of all bodies. */
static inline int fieldmap_points_of(int count, const fieldmap_placed *placed)
{
    int n, points = 0;
    for (n = 0; n < count; n++) points += fieldmap_body_points(placed[n].body);
    return points;
}

static inline int fieldmap_is_soft(const fieldmap_bodies *all, const fieldmap_site *site)
{
    return site->number >= all->placed[site->owner].body->n_dipoles;
}

/* Fill the moment of a site in a flux density. Returns the energy, as fieldmap_body_moment does. */
static inline double fieldmap_site_moment(const fieldmap_bodies *all, const fieldmap_site *site, const double *flux, double *moment)
{
    const fieldmap_placed *of = all->placed + site->owner;
    return fieldmap_body_moment(of->body, site->number, of->turn, flux, moment);
}

/* Fill the positions of the sites from the poses, and the fixed moments. The moments of soft iron are 0. */
static inline void fieldmap_place_bodies(fieldmap_bodies *all)
{
    static const double none[3] = {0.0, 0.0, 0.0};
    fieldmap_site *site = all->sites;
    int n, p, i;
    for (n = 0; n < all->count; n++) {
        const fieldmap_placed *of = all->placed + n;
        for (p = 0; p < fieldmap_body_points(of->body); p++, site++) {
            site->owner = n, site->number = p;
            fieldmap_body_arm(of->body, p, of->turn, site->arm);
            for (i = 0; i < 3; i++) site->at[i] = of->place[i] + site->arm[i], site->moment[i] = site->change[i] = 0.0;
            if (p < of->body->n_dipoles) fieldmap_site_moment(all, site, none, site->moment);
        }
    }
}

/* Add field k of `count` fields at point p, times a factor, to flux[3] and, unless NULL, gradient[9]. */
FIELDMAP_INLINE void fieldmap_add_field(const double *fluxes, const double *gradients, int count, int p, int k, double factor,
                                        double *flux, double *gradient)
{
    const size_t at = (size_t)p * (size_t)count + (size_t)k;
    int i;
    for (i = 0; i < 3; i++) flux[i] += factor * fluxes[3 * at + (size_t)i];
    for (i = 0; i < 9 && gradient != NULL; i++) gradient[i] += factor * gradients[9 * at + (size_t)i];
}

/* Add the reaction with weights w_k at point p to flux[3] and, unless NULL, gradient[9]. */
static inline void fieldmap_add_reaction(const fieldmap_reacting *of, int p, const double *weights, double *flux, double *gradient)
{
    int k;
    for (k = 0; k < of->fields; k++)
        fieldmap_add_field(of->flux, of->gradient, of->fields, p, k, k < of->fields - of->repelled ? weights[k] : -weights[k],
                           flux, gradient);
}

/* Add the contribution of a moment at point p to the weights w_k of the reaction. */
static inline void fieldmap_add_reacting(const fieldmap_reacting *of, int p, const double *moment, double *weights)
{
    const double *each = of->flux + (size_t)p * (size_t)of->fields * 3;
    int k;
    for (k = 0; k < of->fields; k++) weights[k] += fieldmap_dot(moment, each + 3 * k);
}

/* Flux density and, unless NULL, gradient of the external fields and the reaction at point p. */
static inline void fieldmap_field_on_site(const fieldmap_bodies *all, int p, double *flux, double *gradient)
{
    const fieldmap_acting *by = &all->by;
    int k, i;
    for (i = 0; i < 3; i++) flux[i] = 0.0;
    for (i = 0; i < 9 && gradient != NULL; i++) gradient[i] = 0.0;
    for (k = 0; k < by->fields; k++) fieldmap_add_field(by->flux, by->gradient, by->fields, p, k, by->weights[k], flux, gradient);
    fieldmap_add_reaction(&all->of, p, all->weights, flux, gradient);
}

/* Add the field of a dipole `source` at a distance r[3] to flux[3], and its force on a dipole `moment` there to force[3]. */
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

/* Add the field of the moments (or their changes) of all other bodies at site p to flux[3], its force on a dipole `acted` to
 * force[3]. */
static inline void fieldmap_add_others(
    const fieldmap_bodies *all, int p, int changes, const double *acted, double *flux, double *force)
{
    const fieldmap_site *here = all->sites + p, *there = all->sites;
    int q, i;
    for (q = 0; q < all->points && all->count > 1; q++, there++) {
        double r[3];
        if (there->owner == here->owner) continue;
        for (i = 0; i < 3; i++) r[i] = here->at[i] - there->at[i];
        fieldmap_add_dipole(r, changes ? there->change : there->moment, acted, flux, force);
    }
}

/* Find the moments of soft iron, if k < 0, or their derivatives with respect to the weight of field k. Fills the weights of the
 * reaction to them and, if k < 0, also to the fixed moments. Returns whether the iteration converged. */
static inline int fieldmap_settle(fieldmap_bodies *all, int k, double *reacting)
{
    enum { STEPS = 200 };
    static const double none[3] = {0.0, 0.0, 0.0};
    double whole = 0.0, moved = 0.0;
    int p, i, step;
    for (i = 0; i < all->of.fields; i++) reacting[i] = 0.0;
    for (p = 0; p < all->points; p++)
        if (k < 0) fieldmap_add_reacting(&all->of, p, all->sites[p].moment, reacting);
        else for (i = 0; i < 3; i++) all->sites[p].change[i] = 0.0;
    for (step = 0; step < STEPS; step++) {
        whole = moved = 0.0;
        for (p = 0; p < all->points; p++) {
            fieldmap_site *site = all->sites + p;
            double *vector = k < 0 ? site->moment : site->change, flux[3] = {0.0}, unused[3], next[3], by[3];
            if (!fieldmap_is_soft(all, site)) continue;
            if (k < 0) {
                fieldmap_field_on_site(all, p, flux, NULL);
            } else {
                fieldmap_add_field(all->by.flux, NULL, all->by.fields, p, k, 1.0, flux, NULL);
                fieldmap_add_reaction(&all->of, p, reacting, flux, NULL);
            }
            fieldmap_add_others(all, p, k >= 0, none, flux, unused);
            if (k < 0) fieldmap_site_moment(all, site, flux, next);
            else fieldmap_to_map(site->slope, flux, next);
            for (i = 0; i < 3; i++) by[i] = next[i] - vector[i], vector[i] = next[i];
            fieldmap_add_reacting(&all->of, p, by, reacting);
            moved += fieldmap_dot(by, by), whole += fieldmap_dot(next, next);
        }
        if (!(whole < 1e200)) return 0;
        if (moved <= 1e-28 * whole || (all->count == 1 && all->of.fields == 0)) return 1;
    }
    return moved <= 1e-18 * whole;
}

/* Add a force, the torque of a flux density on a moment, and the torque of the force at an arm to wrench[6]. */
FIELDMAP_INLINE void fieldmap_add_force(
    const double *force, const double *flux, const double *moment, const double *arm, double *wrench)
{
    fieldmap_add(force, wrench);
    fieldmap_add_cross(moment, flux, wrench + 3);
    fieldmap_add_cross(arm, force, wrench + 3);
}

/* Fill wrench[6 * count] on the placed bodies, each about its origin, and, unless NULL, the energy of all, J: -m . B of fixed
 * moments and -integral of m dB of soft iron in the whole field, with each pair of bodies and the reaction counted once.
 * Returns whether the moments of soft iron converged. */
static inline int fieldmap_bodies_wrench(fieldmap_bodies *all, double *wrench, double *energy)
{
    const int settled = fieldmap_settle(all, -1, all->weights);
    double sum = 0.0;
    int p, i;
    for (i = 0; i < 6 * all->count; i++) wrench[i] = 0.0;
    for (i = 0; i < all->of.fields; i++)
        sum += (i < all->of.fields - all->of.repelled ? 0.5 : -0.5) * all->weights[i] * all->weights[i];
    for (p = 0; p < all->points; p++) {
        fieldmap_site *site = all->sites + p;
        double *own = wrench + 6 * site->owner, flux[3] = {0.0}, force[3] = {0.0}, unused[3];
        fieldmap_field_on_site(all, p, site->flux, site->gradient);
        fieldmap_add_wrench(site->flux, site->gradient, site->moment, site->arm, own);
        fieldmap_add_others(all, p, 0, site->moment, flux, force);
        fieldmap_add_force(force, flux, site->moment, site->arm, own);
        fieldmap_add(flux, site->flux);
        if (energy != NULL)
            sum += fieldmap_site_moment(all, site, site->flux, unused) + 0.5 * fieldmap_dot(site->moment, flux);
    }
    if (energy != NULL) *energy = sum;
    return settled;
}

/* Add the wrench of the changes of moments with the weight of field k to wrench[6 * count]. Returns whether they converged. */
static inline int fieldmap_add_changes(fieldmap_bodies *all, int k, double *wrench)
{
    double reacting[FIELDMAP_REACTION_FIELDS];
    const int settled = fieldmap_settle(all, k, reacting);
    int p;
    for (p = 0; p < all->points; p++) {
        const fieldmap_site *site = all->sites + p;
        double *own = wrench + 6 * site->owner, flux[3] = {0.0}, gradient[9] = {0.0}, force[3] = {0.0}, near[3] = {0.0};
        if (all->of.fields > 0) {
            fieldmap_add_reaction(&all->of, p, reacting, flux, gradient);
            fieldmap_add_wrench(flux, gradient, site->moment, site->arm, own);
        }
        if (all->count > 1) {
            fieldmap_add_others(all, p, 1, site->moment, near, force);
            fieldmap_add_force(force, near, site->moment, site->arm, own);
        }
        if (!fieldmap_is_soft(all, site)) continue;
        force[0] = force[1] = force[2] = 0.0;
        fieldmap_add_wrench(site->flux, site->gradient, site->change, site->arm, own);
        fieldmap_add_others(all, p, 0, site->change, near, force);
        fieldmap_add(force, own);
        fieldmap_add_cross(site->arm, force, own + 3);
    }
    return settled;
}

/* Fill out[9]: dm/dB of a site of soft iron at its flux density, frame of the map. */
static inline void fieldmap_site_slope(const fieldmap_bodies *all, const fieldmap_site *site, double *out)
{
    const fieldmap_placed *of = all->placed + site->owner;
    double inside[3], own[9];
    fieldmap_to_body(of->turn, site->flux, inside);
    fieldmap_moment_slope(of->body->soft + (site->number - of->body->n_dipoles), inside, own);
    fieldmap_turned_matrix(of->turn, own, out);
}

/* Fill slopes[6 * count * fields], the derivatives of the wrench with respect to the weights of the external fields, after
 * fieldmap_bodies_wrench. Returns whether the changes of moments converged. */
static inline int fieldmap_bodies_slopes(fieldmap_bodies *all, double *room, double *slopes)
{
    const int fields = all->by.fields, rows = 6 * all->count;
    int p, i, k, soft = 0, settled = 1;
    for (p = 0; p < all->points; p++) {
        fieldmap_site *site = all->sites + p;
        if (!fieldmap_is_soft(all, site)) continue;
        soft = 1;
        fieldmap_site_slope(all, site, site->slope);
    }
    for (k = 0; k < fields; k++) {
        for (i = 0; i < rows; i++) room[i] = 0.0;
        for (p = 0; p < all->points; p++) {
            const fieldmap_site *site = all->sites + p;
            const size_t at = (size_t)p * (size_t)fields + (size_t)k;
            fieldmap_add_wrench(all->by.flux + 3 * at, all->by.gradient + 9 * at, site->moment, site->arm, room + 6 * site->owner);
        }
        if (soft) settled &= fieldmap_add_changes(all, k, room);
        for (i = 0; i < rows; i++) slopes[i * fields + k] = room[i];
    }
    return settled;
}

/* Numbers of room that fieldmap_wrench_in_map needs. */
static inline size_t fieldmap_looked_room(const fieldmap *map, int points)
{
    return 12 * (size_t)points * (1 + (size_t)(map->reaction == NULL ? 0 : map->reacting));
}

/* As fieldmap_bodies_wrench, in the field of a map at its weights and in its reaction. room: as fieldmap_looked_room says.
 * Returns the status of the first point at which the field is unknown, with its number in *fault unless NULL. */
static inline int fieldmap_wrench_in_map(
    fieldmap_bodies *all, const fieldmap_path *field, double *room, double *wrench, double *energy, int *fault)
{
    static const double one = 1.0;
    const fieldmap own = fieldmap_reaction(field->map);
    const int fields = field->map->reaction == NULL ? 0 : own.n_coils;
    const size_t points = (size_t)all->points;
    double *flux = room, *gradient = flux + 3 * points, *back = gradient + 9 * points, *slope = back + 3 * points * (size_t)fields;
    int p, status;
    fieldmap_place_bodies(all);
    for (p = 0; p < all->points; p++) {
        const double *at = all->sites[p].at;
        status = fieldmap_path_field(field, p, at, flux + 3 * p, gradient + 9 * p);
        if (status == FIELDMAP_OK && fields > 0)
            fieldmap_each_field(&own, at, back + 3 * (size_t)p * (size_t)fields, slope + 9 * (size_t)p * (size_t)fields);
        if (status == FIELDMAP_OK) continue;
        if (fault != NULL) *fault = p;
        return status;
    }
    all->by.fields = 1, all->by.weights = &one, all->by.flux = flux, all->by.gradient = gradient;
    all->of.fields = fields, all->of.repelled = field->map->repelled, all->of.flux = back, all->of.gradient = slope;
    if (fieldmap_bodies_wrench(all, wrench, energy)) return FIELDMAP_OK;
    if (fault != NULL) *fault = 0;
    return FIELDMAP_UNSETTLED;
}

#endif
