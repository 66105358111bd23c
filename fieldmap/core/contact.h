/* contact.h: penalty forces of floor, ceiling and upright tube on points of a surface (docs/theory/dynamics.md (19), (20)).
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CONTACT_H
#define FIELDMAP_CONTACT_H

#include "rotation.h"

/* Flags of contacts. */
enum { FIELDMAP_FREE = 0, FIELDMAP_ON_FLOOR = 1, FIELDMAP_ON_CEILING = 2, FIELDMAP_ON_WALL = 4, FIELDMAP_ON_BODY = 8 };

/* stiffness, N/m, and damping, N s/m, of the penalty; friction: Coulomb's coefficient; slip: m/s, below which friction is
 * viscous; heights of floor and ceiling, m; radius of the tube and its axis (x, y), m. Absent walls are at infinity. */
typedef struct fieldmap_walls {
    double stiffness, damping, friction, slip, floor, ceiling, radius, axis[2];
} fieldmap_walls;

/* Add the force, frame of the map, and the torque, frame of the body, of a wall with inward normal n[3]. A point of the body,
 * at an arm from the centre of mass, is at a depth inside the wall and moves at v[3]. r[9]: rotation of the body. */
static inline void fieldmap_add_push(const fieldmap_walls *walls, double depth, const double *n, const double *v,
                                     const double *arm, const double *r, double *load)
{
    const double inward = fieldmap_dot(n, v);
    const double pushed = walls->stiffness * depth - walls->damping * inward, normal = pushed > 0.0 ? pushed : 0.0;
    double along[3], force[3], torque[3], own[3], slip, rub;
    int i;
    for (i = 0; i < 3; i++) along[i] = v[i] - inward * n[i];
    slip = sqrt(fieldmap_dot(along, along));
    rub = walls->friction * normal / (slip > walls->slip ? slip : walls->slip);
    for (i = 0; i < 3; i++) force[i] = normal * n[i] - rub * along[i];
    fieldmap_cross(arm, force, torque);
    fieldmap_to_body(r, torque, own);
    fieldmap_add(force, load);
    fieldmap_add(own, load + 3);
}

/* Add the forces and torques of the walls to load[6] of a body with `count` points of its surface at skin[3 * count]. r[9]:
 * rotation of the body; angular_velocity[3]: in its own frame. Returns the flags of the contacts. */
static inline int fieldmap_add_contact(const fieldmap_walls *walls, int count, const double *skin, const double *position,
                                       const double *r, const double *velocity, const double *angular_velocity, double *load)
{
    static const double up[3] = {0.0, 0.0, 1.0}, down[3] = {0.0, 0.0, -1.0};
    double rate[3];
    int p, i, touched = FIELDMAP_FREE;
    fieldmap_to_map(r, angular_velocity, rate);
    for (p = 0; p < count; p++) {
        double arm[3], at[3], v[3], dx, dy, distance;
        int floor, ceiling, wall;
        fieldmap_to_map(r, skin + 3 * p, arm);
        for (i = 0; i < 3; i++) at[i] = position[i] + arm[i], v[i] = velocity[i];
        dx = at[0] - walls->axis[0], dy = at[1] - walls->axis[1], distance = sqrt(dx * dx + dy * dy);
        floor = at[2] < walls->floor, ceiling = at[2] > walls->ceiling, wall = distance > walls->radius;
        if (!(floor || ceiling || wall)) continue;
        fieldmap_add_cross(rate, arm, v);
        if (floor) {
            touched |= FIELDMAP_ON_FLOOR;
            fieldmap_add_push(walls, walls->floor - at[2], up, v, arm, r, load);
        }
        if (ceiling) {
            touched |= FIELDMAP_ON_CEILING;
            fieldmap_add_push(walls, at[2] - walls->ceiling, down, v, arm, r, load);
        }
        if (wall) {
            const double inward[3] = {-dx / distance, -dy / distance, 0.0};
            touched |= FIELDMAP_ON_WALL;
            fieldmap_add_push(walls, distance - walls->radius, inward, v, arm, r, load);
        }
    }
    return touched;
}

#endif
