/* calibration_curve.h: the height of a magnet from the reading of one field sensor, as in desk levitators.
 *
 * The contribution of the currents is subtracted from the reading. A piecewise cubic curve through calibrated points, with
 * given slopes there, gives the height; it is once continuously differentiable. Beyond its ends the curve keeps the height of
 * the end. In fm_real (real.h): double, or single precision for microcontrollers with FIELDMAP_REAL float.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CALIBRATION_CURVE_H
#define FIELDMAP_CALIBRATION_CURVE_H

#include "real.h"

/* constant: reading without currents and magnet, T; per_ampere[n_coils]: contribution of the currents, T/A. Points of the
 * curve, two or more: readings[nodes] of the magnet, T, rising; heights[nodes], m; slopes[nodes], dz/dr, m/T. */
typedef struct fieldmap_calibration_curve {
    int nodes, n_coils;
    fm_real constant;
    const fm_real *per_ampere, *readings, *heights, *slopes;
} fieldmap_calibration_curve;

/* The height, m, for a reading, T, at currents[n_coils], A. */
static inline fm_real fieldmap_height_of_reading(
    const fieldmap_calibration_curve *curve, fm_real reading, const fm_real *currents)
{
    fm_real left = reading - curve->constant, width, t;
    int k, low = 0, high = curve->nodes - 1;
    for (k = 0; k < curve->n_coils; k++) left -= curve->per_ampere[k] * currents[k];
    if (!(left > curve->readings[low])) return curve->heights[low];
    if (!(left < curve->readings[high])) return curve->heights[high];
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (left < curve->readings[middle]) high = middle;
        else low = middle;
    }
    width = curve->readings[high] - curve->readings[low];
    t = (left - curve->readings[low]) / width;
    /* Hermite's cubic, from the lower point. */
    return curve->heights[low]
        + t * (width * curve->slopes[low] * (FM(1) - t) * (FM(1) - t) - width * curve->slopes[high] * t * (FM(1) - t)
               + (curve->heights[high] - curve->heights[low]) * t * (FM(3) - FM(2) * t));
}

#endif
