/* fieldmap.h: flux density, gradient, second gradient and dipole wrench from a map, in C99, with no dependencies.
 *
 * The map is a file that `fieldmap export MAP --to c -o field.fmap` writes; docs/c.md has an example. SI units, z up:
 * points in m, currents in A, B in T, gradient[3 * i + j] = dB_i/dx_j in T/m, second[9 * i + 3 * j + k] =
 * d2B_i/dx_j dx_k in T/m^2, moments in A m^2, wrench = force in N, then torque in N m about the dipole.
 *
 * Every function returns FIELDMAP_OK or the reason why not. Outside the box results are NaN and the status is FIELDMAP_OUTSIDE,
 * unless the map was exported to clamp; NaN and infinity in a point give NaN and FIELDMAP_NOT_FINITE. Opening a map checks its
 * sizes and checksum, so a damaged file is refused. An opened map is never written to, so any number of threads may use it.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_H
#define FIELDMAP_H

#ifdef FIELDMAP32_H
#error "a source file includes fieldmap.h or fieldmap32.h, not both"
#endif

#include <math.h>

#include "map_file.h"

#endif
