/* rotation.h: vectors, rotation matrices, quaternions, and the free motion of a rigid rotor (docs/theory/dynamics.md).
 *
 * A rotation r[9], row by row, takes vectors from the body to the map. A quaternion is turn[4], real part first.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_ROTATION_H
#define FIELDMAP_ROTATION_H

#include <math.h>

#include "real.h"

FIELDMAP_INLINE double fieldmap_dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* out = a x b; out is another array. */
FIELDMAP_INLINE void fieldmap_cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

FIELDMAP_INLINE void fieldmap_add(const double *a, double *sum)
{
    sum[0] += a[0], sum[1] += a[1], sum[2] += a[2];
}

FIELDMAP_INLINE void fieldmap_add_cross(const double *a, const double *b, double *sum)
{
    double product[3];
    fieldmap_cross(a, b, product);
    fieldmap_add(product, sum);
}

/* A vector of the body in the frame of the map; out is another array. */
FIELDMAP_INLINE void fieldmap_to_map(const double *r, const double *v, double *out)
{
    int i;
    for (i = 0; i < 3; i++) out[i] = fieldmap_dot(r + 3 * i, v);
}

/* A vector of the map in the frame of the body; out is another array. */
FIELDMAP_INLINE void fieldmap_to_body(const double *r, const double *v, double *out)
{
    int i;
    for (i = 0; i < 3; i++) out[i] = r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2];
}

/* Fill the rotation r[9] of a unit quaternion. */
FIELDMAP_INLINE void fieldmap_rotation(const double *turn, double *r)
{
    const double w = turn[0], x = turn[1], y = turn[2], z = turn[3];
    const double xx = 2.0 * x * x, yy = 2.0 * y * y, zz = 2.0 * z * z;
    const double xy = 2.0 * x * y, xz = 2.0 * x * z, yz = 2.0 * y * z;
    const double wx = 2.0 * w * x, wy = 2.0 * w * y, wz = 2.0 * w * z;
    r[0] = 1.0 - yy - zz, r[1] = xy - wz, r[2] = xz + wy;
    r[3] = xy + wz, r[4] = 1.0 - xx - zz, r[5] = yz - wx;
    r[6] = xz - wy, r[7] = yz + wx, r[8] = 1.0 - xx - yy;
}

/* The quaternion times (w, x, y, z), which turns about axes of the body. */
FIELDMAP_INLINE void fieldmap_turn_by(double *turn, double w, double x, double y, double z)
{
    const double a = turn[0], b = turn[1], c = turn[2], d = turn[3];
    turn[0] = a * w - b * x - c * y - d * z;
    turn[1] = a * x + b * w + c * z - d * y;
    turn[2] = a * y - b * z + c * w + d * x;
    turn[3] = a * z + b * y - c * x + d * w;
}

/* Correct the rounding of the length of a quaternion by one step of Newton's method for 1 / length. */
FIELDMAP_INLINE void fieldmap_normalise(double *turn)
{
    int k;
    const double square = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3];
    for (k = 0; k < 4; k++) turn[k] *= 1.5 - 0.5 * square;
}

/* sin(x) / x and cos(x) from q = x^2. Taylor's series for small angles, such as rotations of a body in a step, needs no root or
 * division: below q = 0.0025 the first neglected terms, x^10 / 11! and x^10 / 10!, are below 1e-19 of the sum. */
FIELDMAP_INLINE void fieldmap_sinc_and_cosine(double q, double *sinc, double *cosine)
{
    if (q < 0.0025) {
        *sinc = 1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0 - q * (1.0 / 362880.0))));
        *cosine = 1.0 - q * (0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0 - q * (1.0 / 40320.0))));
    } else {
        const double x = sqrt(q);
        *sinc = sin(x) / x;
        *cosine = cos(x);
    }
}

/* Rotate about the second axis of the body by the angle factor * momentum[1]; the momentum in the body rotates back. */
FIELDMAP_INLINE void fieldmap_turn_about_second(double *turn, double *momentum, double factor)
{
    const double first = momentum[0], third = momentum[2], half = 0.5 * factor * momentum[1];
    double sinc, c, s, sine, cosine;
    fieldmap_sinc_and_cosine(half * half, &sinc, &c);
    s = half * sinc, sine = 2.0 * s * c, cosine = c * c - s * s;
    fieldmap_turn_by(turn, c, 0.0, s, 0.0);
    momentum[0] = cosine * first - sine * third;
    momentum[2] = cosine * third + sine * first;
}

/* Advance the quaternion and the angular velocity, frame of the body, of a rotor of principal moments of inertia[3] by a time h
 * without torque; per[3]: 1 / inertia. docs/theory/dynamics.md (3) to (6).
 *
 * The kinetic energy L^2 / (2 I1) + L2^2 (1/I2 - 1/I1) / 2 + L3^2 (1/I3 - 1/I1) / 2, with the angular momentum L in the body,
 * is a sum of parts whose motions are rotations: the first part turns the body about L and commutes with the other parts. With
 * I1 = I2 the second part is absent and the step is exact. Otherwise it is of second order, symmetric in time and symplectic; L
 * keeps its length and its direction in space to rounding. After Dullweber, Leimkuhler and McLachlan, J. Chem. Phys. 107, 5840
 * (1997). */
FIELDMAP_INLINE void fieldmap_free_turn(
    double *turn, double *angular_velocity, const double *inertia, const double *per, double h)
{
    double p[3], about[3], share, sinc, c;
    int k;
    for (k = 0; k < 3; k++) p[k] = inertia[k] * angular_velocity[k], about[k] = p[k] * per[0];
    fieldmap_sinc_and_cosine(0.25 * h * h * fieldmap_dot(about, about), &sinc, &c);
    share = 0.5 * h * sinc;
    fieldmap_turn_by(turn, c, share * about[0], share * about[1], share * about[2]);
    if (inertia[0] != inertia[1]) fieldmap_turn_about_second(turn, p, 0.5 * h * (per[1] - per[0]));
    if (inertia[0] != inertia[2]) {
        const double first = p[0], second = p[1], half = 0.5 * h * p[2] * (per[2] - per[0]);
        double s, sine, cosine;
        fieldmap_sinc_and_cosine(half * half, &sinc, &c);
        s = half * sinc, sine = 2.0 * s * c, cosine = c * c - s * s;
        fieldmap_turn_by(turn, c, 0.0, 0.0, s);
        p[0] = cosine * first + sine * second;
        p[1] = cosine * second - sine * first;
    }
    if (inertia[0] != inertia[1]) fieldmap_turn_about_second(turn, p, 0.5 * h * (per[1] - per[0]));
    for (k = 0; k < 3; k++) angular_velocity[k] = p[k] * per[k];
}

#endif
