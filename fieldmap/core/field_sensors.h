/* field_sensors.h: readings of field sensors near coils, iron, background and a magnetic body (docs/field_sensors.md (1)).
 *
 *     r = sum_k w_k r_k + sum m . B_s(x),   B_s = B_dipole + B_iron
 *
 * The sums run over the fields k of the map and the dipoles m of the body at x. B_s is the field of a dipole of 1 A m^2 at the
 * place and along the axis of the sensor, with the reaction of the iron to this dipole.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_FIELD_SENSORS_H
#define FIELDMAP_FIELD_SENSORS_H

#include "magnetic_body.h"

/* A place, m, and a unit vector, frame of the map. */
typedef struct fieldmap_field_sensor {
    double place[3], axis[3];
} fieldmap_field_sensor;

/* shares[count * sets]: readings of the map's sets at weight 1, T, sensor by sensor; the last set is the one that no current
 * drives, if there is one. answers: a map of the fields B_iron, one set for each sensor, T/(A m^2); NULL without iron. */
typedef struct fieldmap_field_sensors {
    int count;
    const fieldmap_field_sensor *sensors;
    const double *shares;
    const fieldmap *answers;
} fieldmap_field_sensors;

/* Add the readings of a dipole of moment[3] at a point to readings[count]. Returns the status of the map `answers`. */
static inline int fieldmap_add_dipole_readings(
    const fieldmap_field_sensors *of, const double *point, const double *moment, double *readings)
{
    int s, i;
    for (s = 0; s < of->count; s++) {
        const fieldmap_field_sensor *sensor = of->sensors + s;
        double from[3], square, distance;
        for (i = 0; i < 3; i++) from[i] = point[i] - sensor->place[i];
        square = fieldmap_dot(from, from), distance = sqrt(square);
        readings[s] += FIELDMAP_MU0_OVER_4PI / (square * distance)
            * (3.0 * fieldmap_dot(sensor->axis, from) * fieldmap_dot(moment, from) / square - fieldmap_dot(sensor->axis, moment));
    }
    return of->answers == NULL ? FIELDMAP_OK : fieldmap_add_along(of->answers, point, moment, readings);
}

/* Fill readings[count] for a body at a place with rotation r[9] in a field. Returns the status of the first point of the body
 * at which the field is unknown. */
static inline int fieldmap_read_sensors(const fieldmap_field_sensors *of, const fieldmap_path *field,
                                        const fieldmap_magnetic_body *body, const double *place, const double *r, double *readings)
{
    const int sets = fieldmap_sets(field->map);
    double room[FIELDMAP_REACTION_FIELDS], at[3];
    const double *reacting = NULL;
    int s, k, p, status = FIELDMAP_OK;
    for (s = 0; s < of->count; s++) {
        const double *share = of->shares + (size_t)s * (size_t)sets;
        readings[s] = field->map->constant ? share[field->map->n_coils] : 0.0;
        for (k = 0; k < field->map->n_coils; k++) readings[s] += share[k] * field->weights[k];
    }
    if (body->n_soft > 0) status = fieldmap_body_reaction(field, body, place, r, room, &reacting, at);
    for (p = 0; p < fieldmap_body_points(body) && status == FIELDMAP_OK; p++) {
        double moment[3];
        status = fieldmap_body_dipole(field, body, place, r, p, reacting, at, moment);
        if (status == FIELDMAP_OK) status = fieldmap_add_dipole_readings(of, at, moment, readings);
    }
    return status;
}

#endif
