/* several_bodies.h: the motion of bodies that act on each other in the field of one machine, by the steps of rigid_body.h.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_SEVERAL_BODIES_H
#define FIELDMAP_SEVERAL_BODIES_H

#include "bodies.h"
#include "machine.h"

/* machine: its field follows the currents; its own body is not used. field: the field of the machine, with the kept sums of all
 * points. radii: of spheres about the centres of mass with which bodies touch each other, m; 0: no contact. contact: stiffness
 * and damping are per kg of the reduced mass of a pair. all, placed, room, wrench: as in fieldmap_wrench_in_map. fault: number
 * of the point at which the field was unknown. */
typedef struct fieldmap_several {
    fieldmap_machine *machine;
    fieldmap_path field;
    int count;
    const fieldmap_rigid_body *bodies;
    const double *radii;
    fieldmap_walls contact;
    fieldmap_bodies all;
    fieldmap_placed *placed;
    double *room, *wrench;
    int fault;
} fieldmap_several;

/* As fieldmap_machine_follow. */
static inline int fieldmap_several_follow(fieldmap_several *of, const double *currents)
{
    const int within = fieldmap_machine_follow(of->machine, currents);
    fieldmap_path_forget(&of->field);
    return within;
}

/* Fill of->wrench on the magnets at given states, and, unless NULL, their energy. Returns a status. */
static inline int fieldmap_several_wrench(fieldmap_several *of, const fieldmap_state *states, double *energy)
{
    int n, i;
    for (n = 0; n < of->count; n++) {
        for (i = 0; i < 3; i++) of->placed[n].place[i] = states[n].position[i];
        fieldmap_rotation(states[n].turn, of->placed[n].turn);
    }
    return fieldmap_wrench_in_map(&of->all, &of->field, of->room, of->wrench, energy, &of->fault);
}

/* Add the contact forces of the spheres of bodies a and b, at one point, to their loads. Returns whether they touch. */
static inline int fieldmap_add_collision(const fieldmap_several *of, const fieldmap_state *states, int a, int b, double *loads)
{
    const double first = of->bodies[a].mass, second = of->bodies[b].mass, reduced = first * second / (first + second);
    const double *const turns[2] = {of->placed[a].turn, of->placed[b].turn};
    fieldmap_walls contact = of->contact;
    double n[3], back[3], v[3], opposite[3], arms[2][3], rates[2][3], distance, depth;
    int i;
    if (!(of->radii[a] > 0.0 && of->radii[b] > 0.0)) return 0;
    for (i = 0; i < 3; i++) n[i] = states[a].position[i] - states[b].position[i];
    distance = sqrt(fieldmap_dot(n, n)), depth = of->radii[a] + of->radii[b] - distance;
    if (!(depth > 0.0)) return 0;
    fieldmap_to_map(turns[0], states[a].angular_velocity, rates[0]);
    fieldmap_to_map(turns[1], states[b].angular_velocity, rates[1]);
    for (i = 0; i < 3; i++) {
        n[i] /= distance, back[i] = -n[i];
        arms[0][i] = -(of->radii[a] - 0.5 * depth) * n[i], arms[1][i] = (of->radii[b] - 0.5 * depth) * n[i];
        v[i] = states[b].velocity[i];
    }
    fieldmap_add_cross(rates[1], arms[1], v);
    for (i = 0; i < 3; i++) v[i] = states[a].velocity[i] - v[i];
    fieldmap_add_cross(rates[0], arms[0], v);
    for (i = 0; i < 3; i++) opposite[i] = -v[i];
    contact.stiffness *= reduced, contact.damping *= reduced;
    fieldmap_add_push(&contact, depth, n, v, arms[0], turns[0], loads + 6 * a);
    fieldmap_add_push(&contact, depth, back, opposite, arms[1], turns[1], loads + 6 * b);
    return 1;
}

/* Fill loads[6 * count] as fieldmap_load does, with contacts between bodies, and all contact flags. Returns a status. */
static inline int fieldmap_several_load(fieldmap_several *of, const fieldmap_state *states, double *loads, int *touched)
{
    const int status = fieldmap_several_wrench(of, states, NULL);
    int a, b;
    *touched = FIELDMAP_FREE;
    for (a = 0; a < of->count && status == FIELDMAP_OK; a++)
        *touched |= fieldmap_load_of_wrench(of->bodies + a, states + a, of->placed[a].turn, of->wrench + 6 * a, loads + 6 * a);
    for (a = 0; a < of->count && status == FIELDMAP_OK; a++)
        for (b = 0; b < a; b++)
            if (fieldmap_add_collision(of, states, a, b, loads)) *touched |= FIELDMAP_ON_BODY;
    return status;
}

/* As fieldmap_symmetric_step, for all bodies at once. */
static inline int fieldmap_several_symmetric_step(
    fieldmap_several *of, fieldmap_state *states, double *loads, double h, int order, int *touched)
{
    double per[6];
    int n, status;
    for (n = 0; n < of->count; n++) {
        fieldmap_mobility(of->bodies + n, per);
        fieldmap_kick(of->bodies + n, per, of->placed[n].turn, states + n, loads + 6 * n, 0.5 * h, order);
        fieldmap_fly(of->bodies + n, per, states + n, h);
    }
    status = fieldmap_several_load(of, states, loads, touched);
    for (n = 0; n < of->count && status == FIELDMAP_OK; n++) {
        fieldmap_mobility(of->bodies + n, per);
        fieldmap_kick(of->bodies + n, per, of->placed[n].turn, states + n, loads + 6 * n, 0.5 * h, order);
    }
    return status;
}

/* As fieldmap_move, for all bodies; a row holds the states of all. loads[6 * count]: room. */
static inline long fieldmap_several_move(fieldmap_several *of, fieldmap_state *states, double *loads, double h, long every,
                                         int order, long rows, fieldmap_state *out, int *status, int *touched)
{
    double lengths[3];
    const size_t bytes = (size_t)of->count * sizeof *states;
    const int parts = fieldmap_parts_of_step(order, lengths);
    long row, n;
    int now, part;
    *status = fieldmap_several_load(of, states, loads, touched);
    memcpy(out, states, bytes);
    for (row = 1; row < rows && *status == FIELDMAP_OK; row++) {
        for (n = 0; n < every * parts && *status == FIELDMAP_OK; n++) {
            part = (int)(n % parts);
            *status = fieldmap_several_symmetric_step(of, states, loads, lengths[part] * h, order, &now);
            *touched |= now;
        }
        if (*status != FIELDMAP_OK) break;
        memcpy(out + row * of->count, states, bytes);
    }
    return row;
}

#endif
