/* flux_linkage.h: flux linkages and incremental inductances of coils, with saturating iron and a payload
 * (docs/theory/flux_linkage.md).
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_FLUX_LINKAGE_H
#define FIELDMAP_FLUX_LINKAGE_H

#include "iron.h"
#include "magnetic_body.h"

/* Fill inductance[n * n], H, of n coils from iron[n * n], mu0 times the part of saturating iron; both may be the same array. */
static inline void fieldmap_add_iron_inductance(const fieldmap_linkage *of, const double *iron, double *inductance)
{
    const int n = of->coils;
    int k, j;
    for (k = 0; k < n; k++)
        for (j = 0; j <= k; j++) {
            const double both = 0.5 * (iron[k * n + j] + iron[j * n + k]) / FIELDMAP_MU0;
            inductance[k * n + j] = inductance[j * n + k] = of->inductance[k * n + j] + both;
        }
}

/* Fill linkages[n], Wb, and, unless NULL, inductance[n * n], H, of n coils and saturating iron at currents[n]; weights and
 * slopes are as in fieldmap_iron_slopes. */
static inline int fieldmap_solve_linkages(fieldmap_iron_state *state, const fieldmap_linkage *of, const double *currents,
                                          double *weights, double *slopes, double *linkages, double *inductance)
{
    const int n = of->coils, status = fieldmap_iron_linked_slopes(state, currents, weights, slopes, linkages, inductance);
    int k;
    if (status != FIELDMAP_OK) {
        fieldmap_unknown(linkages, n);
        if (inductance != NULL) fieldmap_unknown(inductance, n * n);
        return status;
    }
    for (k = 0; k < n; k++) linkages[k] /= FIELDMAP_MU0;
    fieldmap_add_linkages(of, currents, linkages);
    if (inductance != NULL) fieldmap_add_iron_inductance(of, inductance, inductance);
    return status;
}

/* Add the linkages of a payload to linkages[coils]. along[fields]: its m . b in each field of the map; slopes: of the weights
 * of saturating iron, or NULL. */
static inline void fieldmap_add_payload_linkages(
    int coils, int fields, const double *along, const double *slopes, double *linkages)
{
    int k, f;
    for (k = 0; k < coils; k++) linkages[k] += along[k];
    for (f = coils; f < fields && slopes != NULL; f++)
        for (k = 0; k < coils; k++) linkages[k] += slopes[f * coils + k] * along[f];
}

#endif
