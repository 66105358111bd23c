/* division.h: six currents as a lift and two directions (fieldmap.currents.LiftAndDirections; docs/theory/control.md).
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_DIVISION_H
#define FIELDMAP_DIVISION_H

#include <math.h>

/* The six currents of a lift u and directions x, y. n: factor of x in the currents of the two coils on the x axis. */
static inline void fieldmap_divide(double u, double x, double y, double n, double *currents)
{
    double half;
    currents[0] = u * (1.0 - x) * (1.0 - y), currents[2] = u * (1.0 - x) * (1.0 + y);
    currents[3] = u * (1.0 + x) * (1.0 - y), currents[5] = u * (1.0 + x) * (1.0 + y);
    half = 3.0 * u - 0.5 * (currents[0] + currents[2] + currents[3] + currents[5]);
    currents[1] = half * (1.0 - n * x), currents[4] = half * (1.0 + n * x);
}

/* Fill signals[3], the u, x and y whose currents are nearest to currents[6]. Returns the largest difference of these currents
 * as a share of u. If the mean current is 0, the signals are 0 and the result is infinity. */
static inline double fieldmap_division_signals(const double *currents, double n, double *signals)
{
    double u = 0.0, worst = 0.0, near[6];
    int k;
    for (k = 0; k < 6; k++) u += currents[k];
    u /= 6.0;
    signals[0] = signals[1] = signals[2] = 0.0;
    if (u == 0.0) return (double)INFINITY;
    signals[0] = u;
    signals[1] = currents[3] + currents[5] - currents[0] - currents[2] + n * (currents[4] - currents[1]);
    signals[1] /= (4.0 + 2.0 * n * n) * u;
    signals[2] = (currents[2] + currents[5] - currents[0] - currents[3]) / (4.0 * u);
    fieldmap_divide(u, signals[1], signals[2], n, near);
    for (k = 0; k < 6; k++) worst = fmax(worst, fabs(near[k] - currents[k]));
    return worst / fabs(u);
}

#endif
