/* real.h: floating-point type of the run time, and number of points that it processes at a time.
 *
 * The type is double, or FIELDMAP_REAL: float for microcontrollers. Constants are written FM(0.5), so that a build in float
 * computes nothing in double. Loops process FIELDMAP_LANES points side by side, which compilers vectorise.
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

/* FIELDMAP_INLINE: functions for which the compiler must know the number of lanes to vectorise loops, and small steps of the
 * mechanics for which inlining was measured to be faster. FIELDMAP_RESTRICT: `restrict` has another name in C++. */
#if defined(__GNUC__) || defined(__clang__)
#define FIELDMAP_INLINE static inline __attribute__((always_inline))
#define FIELDMAP_RESTRICT __restrict__
#else
#define FIELDMAP_INLINE static inline
#define FIELDMAP_RESTRICT
#endif

/* x - x is NaN for infinity and NaN. No library function is needed. */
static inline int fieldmap_finite(fm_real x)
{
    return x - x == FM(0);
}

#endif
