/* rigid_body.h: the motion of a rigid body with magnets in a field, by steps (docs/theory/dynamics.md (21) to (24)).
 *
 * A step is Strang's splitting into kicks and free flight. A kick changes the velocities at a fixed pose, under magnets, walls,
 * weight and losses. In a flight the body moves freely. A half kick, a flight and a half kick make a step of second order that
 * is symmetric in time and, without losses, symplectic. Three such steps of x1, x0, x1 times the length make one of fourth
 * order (Yoshida, Phys. Lett. A 150, 262, 1990).
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_RIGID_BODY_H
#define FIELDMAP_RIGID_BODY_H

#include "contact.h"
#include "losses.h"

/* Position and velocity of the centre of mass, frame of the map; quaternion from the body to the map; angular velocity,
 * frame of the body. Thirteen numbers in this order. */
typedef struct fieldmap_state {
    double position[3], velocity[3], turn[4], angular_velocity[3];
} fieldmap_state;

enum { FIELDMAP_STATE = 13 };

/* A rigid body. The origin of its frame is the centre of mass, and its axes are principal axes of inertia. inertia: principal
 * moments, kg m^2; gravity: acceleration, m/s^2; force, N, and torque, N m: disturbances, frame of the map. seen_by_plate: one
 * dipole that represents the magnets for the plate. skin: n_skin points of the surface for contacts. lossy: there is drag. */
typedef struct fieldmap_rigid_body {
    double mass, inertia[3], gravity[3], force[3], torque[3];
    int lossy, n_skin;
    fieldmap_drag drag;
    fieldmap_plate plate;
    fieldmap_dipole seen_by_plate;
    fieldmap_walls walls;
    const double *skin;
    fieldmap_magnetic_body magnetic;
} fieldmap_rigid_body;

/* Fill load[6] at a state with rotation r[9] from the wrench[6] on the magnets: force, frame of the map, and torque about the
 * centre of mass, frame of the body, without losses. Returns the contacts. */
FIELDMAP_INLINE int fieldmap_load_of_wrench(const fieldmap_rigid_body *body, const fieldmap_state *state, const double *r,
                                            const double *wrench, double *load)
{
    double torque[3];
    int i;
    for (i = 0; i < 3; i++) {
        load[i] = wrench[i] + body->mass * body->gravity[i] + body->force[i];
        torque[i] = wrench[3 + i] + body->torque[i];
    }
    fieldmap_to_body(r, torque, load + 3);
    if (body->n_skin == 0) return FIELDMAP_FREE;
    return fieldmap_add_contact(&body->walls, body->n_skin, body->skin, state->position, r, state->velocity,
                                state->angular_velocity, load);
}

/* The same in a field. Returns the status of the map. Where the field is unknown the load does not change. */
FIELDMAP_INLINE int fieldmap_load_turned(const fieldmap_path *field, const fieldmap_rigid_body *body,
                                         const fieldmap_state *state, const double *r, double *load, int *touched)
{
    double wrench[6];
    const int status = fieldmap_body_wrench(field, &body->magnetic, state->position, r, wrench, NULL);
    *touched = FIELDMAP_FREE;
    if (status == FIELDMAP_OK) *touched = fieldmap_load_of_wrench(body, state, r, wrench, load);
    return status;
}

/* As fieldmap_load_turned, with the rotation of the state. */
static inline int fieldmap_load(const fieldmap_path *field, const fieldmap_rigid_body *body, const fieldmap_state *state,
                                double *load, int *touched)
{
    double r[9];
    fieldmap_rotation(state->turn, r);
    return fieldmap_load_turned(field, body, state, r, load, touched);
}

/* Force[3], frame of the map, and torque[3], frame of the body, of the losses at given velocities. */
FIELDMAP_INLINE void fieldmap_losses(const fieldmap_rigid_body *body, const double *position, const double *r,
                                   const double *velocity, const double *angular_velocity, double *force, double *torque)
{
    int i;
    for (i = 0; i < 3; i++) force[i] = torque[i] = 0.0;
    if (body->lossy) fieldmap_add_drag(&body->drag, r, velocity, angular_velocity, force, torque);
    if (body->plate.conductivity > 0.0)
        fieldmap_add_eddies(&body->plate, &body->seen_by_plate, position, r, velocity, angular_velocity, force, torque);
}

/* Whether a body has losses. */
FIELDMAP_INLINE int fieldmap_loses(const fieldmap_rigid_body *body)
{
    return body->lossy || body->plate.conductivity > 0.0;
}

/* Fill per[6]: inverses of mass and of the principal moments of inertia. */
FIELDMAP_INLINE void fieldmap_mobility(const fieldmap_rigid_body *body, double *per)
{
    int i;
    per[0] = per[1] = per[2] = 1.0 / body->mass;
    for (i = 0; i < 3; i++) per[3 + i] = 1.0 / body->inertia[i];
}

/* Fill rates[6] at velocities[6]: acceleration, and angular acceleration without the gyroscopic part. per: of
 * fieldmap_mobility. */
FIELDMAP_INLINE void fieldmap_changes(const fieldmap_rigid_body *body, const double *per, const double *position,
                                      const double *r, const double *load, const double *velocities, double *rates)
{
    double force[3], torque[3];
    int i;
    fieldmap_losses(body, position, r, velocities, velocities + 3, force, torque);
    for (i = 0; i < 3; i++) {
        rates[i] = (load[i] + force[i]) * per[i];
        rates[3 + i] = (load[3 + i] + torque[i]) * per[3 + i];
    }
}

/* Change the velocities by a load over a time h at a fixed pose; with losses by a Runge-Kutta rule of second or fourth
 * order. */
FIELDMAP_INLINE void fieldmap_kick(const fieldmap_rigid_body *body, const double *per, const double *r, fieldmap_state *state,
                                   const double *load, double h, int order)
{
    double from[6], at[6], k[4][6];
    int i, stage;
    if (!fieldmap_loses(body)) {
        for (i = 0; i < 3; i++) {
            state->velocity[i] += h * load[i] * per[i];
            state->angular_velocity[i] += h * load[3 + i] * per[3 + i];
        }
        return;
    }
    for (i = 0; i < 3; i++) from[i] = state->velocity[i], from[3 + i] = state->angular_velocity[i];
    for (i = 0; i < 6; i++) at[i] = from[i];
    for (stage = 0; stage < order; stage++) {
        fieldmap_changes(body, per, state->position, r, load, at, k[stage]);
        for (i = 0; i < 6; i++) at[i] = from[i] + (stage < 2 ? 0.5 * h : h) * k[stage][i];
    }
    for (i = 0; i < 6; i++) {
        if (order == 4) from[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
        else from[i] += h * k[1][i];
    }
    for (i = 0; i < 3; i++) state->velocity[i] = from[i], state->angular_velocity[i] = from[3 + i];
}

/* Free motion for a time h. */
FIELDMAP_INLINE void fieldmap_fly(const fieldmap_rigid_body *body, const double *per, fieldmap_state *state, double h)
{
    int i;
    for (i = 0; i < 3; i++) state->position[i] += h * state->velocity[i];
    fieldmap_free_turn(state->turn, state->angular_velocity, body->inertia, per + 3, h);
    fieldmap_normalise(state->turn);
}

/* The first half of a step of second order: half a kick under load[6] by a rule of `order`, then the flight. Fills r[9], the
 * rotation after the flight, and per[6], as fieldmap_mobility does. */
FIELDMAP_INLINE void fieldmap_leave(const fieldmap_rigid_body *body, double *per, double *r, fieldmap_state *state,
                                    const double *load, double h, int order)
{
    fieldmap_mobility(body, per);
    fieldmap_rotation(state->turn, r);
    fieldmap_kick(body, per, r, state, load, 0.5 * h, order);
    fieldmap_fly(body, per, state, h);
    fieldmap_rotation(state->turn, r);
}

/* The second half: compute the load at the end, and apply half a kick. Returns the status of the map, and fills `touched`. */
FIELDMAP_INLINE int fieldmap_arrive(const fieldmap_path *field, const fieldmap_rigid_body *body, const double *per,
                                    const double *r, fieldmap_state *state, double *load, double h, int order, int *touched)
{
    const int status = fieldmap_load_turned(field, body, state, r, load, touched);
    if (status == FIELDMAP_OK) fieldmap_kick(body, per, r, state, load, 0.5 * h, order);
    return status;
}

/* A step of second order, with kicks by a rule of `order`. load[6] is the load at the beginning, and afterwards the load at the
 * end. The field has the weights of the end. Returns the status of the map, and fills `touched`, both at the end. */
FIELDMAP_INLINE int fieldmap_symmetric_step(const fieldmap_path *field, const fieldmap_rigid_body *body, fieldmap_state *state,
                                          double *load, double h, int order, int *touched)
{
    double per[6], r[9];
    fieldmap_leave(body, per, r, state, load, h, order);
    return fieldmap_arrive(field, body, per, r, state, load, h, order, touched);
}

/* Fill the lengths, as fractions, of the symmetric steps in a step of second or fourth order. Returns their number. */
FIELDMAP_INLINE int fieldmap_parts_of_step(int order, double *lengths)
{
    const double x1 = 1.3512071919596578; /* 1 / (2 - 2^(1/3)) */
    lengths[0] = lengths[2] = order == 2 ? 1.0 : x1, lengths[1] = 1.0 - 2.0 * x1;
    return order == 2 ? 1 : 3;
}

/* A step of second or fourth order. The weights must be constant in a step of fourth order. */
static inline int fieldmap_step(const fieldmap_path *field, const fieldmap_rigid_body *body, fieldmap_state *state,
                                double *load, double h, int order, int *touched)
{
    double lengths[3];
    const int parts = fieldmap_parts_of_step(order, lengths);
    int part, status = FIELDMAP_OK;
    for (part = 0; part < parts && status == FIELDMAP_OK; part++)
        status = fieldmap_symmetric_step(field, body, state, load, lengths[part] * h, order, touched);
    return status;
}

/* The time derivative of a state: the right-hand side for other integrators. */
static inline int fieldmap_rates(
    const fieldmap_path *field, const fieldmap_rigid_body *body, const fieldmap_state *state, fieldmap_state *out)
{
    const double *q = state->turn, *s = state->angular_velocity, *inertia = body->inertia;
    double r[9], per[6], load[6], velocities[6], changes[6];
    int i, touched, status = fieldmap_load(field, body, state, load, &touched);
    if (status != FIELDMAP_OK) return status;
    fieldmap_rotation(q, r);
    for (i = 0; i < 3; i++) velocities[i] = state->velocity[i], velocities[3 + i] = s[i];
    fieldmap_mobility(body, per);
    fieldmap_changes(body, per, state->position, r, load, velocities, changes);
    out->turn[0] = -0.5 * (q[1] * s[0] + q[2] * s[1] + q[3] * s[2]);
    out->turn[1] = 0.5 * (q[0] * s[0] + q[2] * s[2] - q[3] * s[1]);
    out->turn[2] = 0.5 * (q[0] * s[1] + q[3] * s[0] - q[1] * s[2]);
    out->turn[3] = 0.5 * (q[0] * s[2] + q[1] * s[1] - q[2] * s[0]);
    for (i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        out->position[i] = state->velocity[i], out->velocity[i] = changes[i];
        out->angular_velocity[i] = changes[3 + i] + (inertia[j] - inertia[k]) / inertia[i] * s[j] * s[k];
    }
    return FIELDMAP_OK;
}

#endif
