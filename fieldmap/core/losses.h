/* losses.h: losses of a moving body by drag and by eddy currents in a conducting plate.
 *
 * docs/theory/dynamics.md (9) to (18). The plate has any thickness and extends to infinity sideways; motion is slow.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_LOSSES_H
#define FIELDMAP_LOSSES_H

#include "magnetic_body.h"

/* Drag coefficients by axis. Axes of the map: linear, N s/m. Axes of the body: body_linear, N s/m, body_quadratic, N s^2/m^2,
 * and for rotation turning, N m s, turning_quadratic, N m s^2. */
typedef struct fieldmap_drag {
    double linear[3], body_linear[3], body_quadratic[3], turning[3], turning_quadratic[3];
} fieldmap_drag;

/* A conducting plate. conductivity: S/m, 0 for none; thickness, m; a point of its face, m; normal: of the face, of length
 * 1, to the side of the magnet. */
typedef struct fieldmap_plate {
    double conductivity, thickness, face[3], normal[3];
} fieldmap_plate;

/* A dipole in motion, frame of the map: its place, moment, velocity, and the rate of change of the moment. */
typedef struct fieldmap_moving_dipole {
    double place[3], moment[3], velocity[3], rate[3];
} fieldmap_moving_dipole;

/* Split a vector: returns its component along the unit vector n, and fills `plane` with the rest. */
FIELDMAP_INLINE double fieldmap_split(const double *vector, const double *n, double *plane)
{
    const double along = fieldmap_dot(vector, n);
    int i;
    for (i = 0; i < 3; i++) plane[i] = vector[i] - along * n[i];
    return along;
}

/* Force[3] of eddy currents on a dipole, and turning[3] with torque = moment x turning: (16), (17). The formula is singular on
 * the face; on or behind the face results are NaN. */
FIELDMAP_INLINE void fieldmap_plate_force(
    const fieldmap_plate *plate, const fieldmap_moving_dipole *dipole, double *force, double *turning)
{
    const double pi = 3.14159265358979323846, *n = plate->normal;
    const double k = FIELDMAP_MU0 * FIELDMAP_MU0 * plate->conductivity / (8.0 * pi);
    double height = 0.0, near, far, a4, a3, a2, m[3], v[3], r[3], mn, vn, rn, m2, mv, mr;
    int i;
    for (i = 0; i < 3; i++) height += n[i] * (dipole->place[i] - plate->face[i]);
    /* Integrals over the depth of the plate of 3 / (8 s^4), 1 / (4 s^3), 1 / (4 s^2): (14), (15). */
    near = 1.0 / height, far = 1.0 / (height + plate->thickness);
    if (!(height > 0.0)) near = far = NAN;
    a4 = k * 0.125 * (near * near * near - far * far * far);
    a3 = k * 0.125 * (near * near - far * far);
    a2 = k * 0.25 * (near - far);
    /* Parts along the normal, and in the plane. */
    mn = fieldmap_split(dipole->moment, n, m);
    vn = fieldmap_split(dipole->velocity, n, v);
    rn = fieldmap_split(dipole->rate, n, r);
    m2 = fieldmap_dot(m, m), mv = fieldmap_dot(m, v), mr = fieldmap_dot(m, r);
    for (i = 0; i < 3; i++) {
        force[i] = -a4 * (0.5 * mn * mn + 0.125 * m2) * v[i] - (0.25 * a4 * mv + 0.5 * a3 * rn) * m[i]
            + 0.5 * a3 * mn * r[i] + (a3 * (0.5 * mr + mn * rn) - a4 * (mn * mn + 0.5 * m2) * vn) * n[i];
        turning[i] = -0.5 * a2 * r[i] + 0.5 * a3 * vn * m[i] + 0.5 * a3 * mn * v[i]
            + (a3 * (mn * vn - 0.5 * mv) - a2 * rn) * n[i];
    }
}

FIELDMAP_INLINE double fieldmap_resist(double linear, double quadratic, double speed)
{
    return -(linear + quadratic * fabs(speed)) * speed;
}

/* Add the force, frame of the map, and the torque, frame of the body, of drag on a body with rotation r[9]. velocity[3]: frame
 * of the map; angular_velocity[3]: frame of the body. */
FIELDMAP_INLINE void fieldmap_add_drag(const fieldmap_drag *drag, const double *r, const double *velocity,
                                     const double *angular_velocity, double *force, double *torque)
{
    double own[3], along[3], in_map[3];
    int i;
    fieldmap_to_body(r, velocity, own);
    for (i = 0; i < 3; i++) along[i] = fieldmap_resist(drag->body_linear[i], drag->body_quadratic[i], own[i]);
    fieldmap_to_map(r, along, in_map);
    for (i = 0; i < 3; i++) {
        force[i] += in_map[i] - drag->linear[i] * velocity[i];
        torque[i] += fieldmap_resist(drag->turning[i], drag->turning_quadratic[i], angular_velocity[i]);
    }
}

/* The same for eddy currents in a plate. position[3]: of the body; seen: one dipole that represents its magnets. */
FIELDMAP_INLINE void fieldmap_add_eddies(const fieldmap_plate *plate, const fieldmap_dipole *seen, const double *position,
                                       const double *r, const double *velocity, const double *angular_velocity,
                                       double *force, double *torque)
{
    fieldmap_moving_dipole dipole;
    double arm[3], rate[3], push[3], turning[3], twist[3] = {0.0}, own[3];
    int i;
    fieldmap_to_map(r, seen->moment, dipole.moment);
    fieldmap_to_map(r, seen->point, arm);
    fieldmap_to_map(r, angular_velocity, rate);
    for (i = 0; i < 3; i++) dipole.place[i] = position[i] + arm[i], dipole.velocity[i] = velocity[i];
    fieldmap_add_cross(rate, arm, dipole.velocity);
    fieldmap_cross(rate, dipole.moment, dipole.rate);
    fieldmap_plate_force(plate, &dipole, push, turning);
    fieldmap_add_cross(dipole.moment, turning, twist);
    fieldmap_add_cross(arm, push, twist);
    fieldmap_to_body(r, twist, own);
    fieldmap_add(push, force);
    fieldmap_add(own, torque);
}

#endif
