/* real.h: the number that the run time computes with, and how many points it takes at a time.
 *
 * double, or what FIELDMAP_REAL says: float for microcontrollers. Constants are written R(0.5), so that a build in float
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

typedef FIELDMAP_REAL real;

#define R(number) ((real)(number))

/* For functions whose number of lanes must be known where they are called, so that loops over lanes become vectors. */
#if defined(__GNUC__) || defined(__clang__)
#define FIELDMAP_INLINE static inline __attribute__((always_inline))
#else
#define FIELDMAP_INLINE static inline
#endif

/* Infinity less itself, and NaN less itself, are not 0. No function of a library is needed. */
static inline int fieldmap_finite(real x)
{
    return x - x == R(0);
}

#endif
