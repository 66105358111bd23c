/* wrench.h: force and torque of a field on a dipole (docs/theory/wrench.md).
 *
 * A wrench is a force in N, then a torque in N m.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_WRENCH_H
#define FIELDMAP_WRENCH_H

#include "real.h"

/* wrench[6] on a dipole of moment[3], A m^2, about its place: F_j = m_i dB_i/dx_j, T = m x B. */
FIELDMAP_INLINE void fieldmap_dipole_wrench(const fm_real *flux, const fm_real *gradient, const fm_real *moment, fm_real *wrench)
{
    int j;
    for (j = 0; j < 3; j++)
        wrench[j] = moment[0] * gradient[j] + moment[1] * gradient[3 + j] + moment[2] * gradient[6 + j];
    wrench[3] = moment[1] * flux[2] - moment[2] * flux[1];
    wrench[4] = moment[2] * flux[0] - moment[0] * flux[2];
    wrench[5] = moment[0] * flux[1] - moment[1] * flux[0];
}

#endif
