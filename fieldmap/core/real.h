/* real.h: the number that the run time computes with, and how many points it takes at a time.
 *
 * double, or what FIELDMAP_REAL says: float for microcontrollers. Constants are written FM(0.5), so that a build in float
 * computes nothing in double. FIELDMAP_LANES points go through a loop side by side, which compilers turn into vectors.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_REAL_H
#define FIELDMAP_REAL_H

#include <stddef.h>
#include <stdint.h>

#ifndef FIELDMAP_REAL
#define FIELDMAP_REAL double
#endif
#ifndef FIELDMAP_LANES
#define FIELDMAP_LANES 8
#endif

typedef FIELDMAP_REAL fm_real;

#define FM(number) ((fm_real)(number))

/* For functions whose number of lanes must be known where they are called, so that loops over lanes become vectors, and for
 * small steps of the mechanics that were measured to be quicker so. C++ knows the other word by another name. */
#if defined(__GNUC__) || defined(__clang__)
#define FIELDMAP_INLINE static inline __attribute__((always_inline))
#define FIELDMAP_RESTRICT __restrict__
#else
#define FIELDMAP_INLINE static inline
#define FIELDMAP_RESTRICT
#endif

/* Infinity less itself, and NaN less itself, are not 0. No function of a library is needed. */
static inline int fieldmap_finite(fm_real x)
{
    return x - x == FM(0);
}

#endif
