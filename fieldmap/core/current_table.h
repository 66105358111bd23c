/* current_table.h: weights of a map's fields from a table over the signals of a division of six currents.
 *
 * The table is interpolated by a tensor product of cubic splines. The basis functions follow from the recurrence of Cox and
 * de Boor (C. de Boor, A Practical Guide to Splines, Springer 1978, X (4)). For currents that do not belong to any signals,
 * or lie outside the table, the weights are extrapolated linearly from the nearest signals in the table, with their slopes by
 * the six currents: docs/theory/current_dependence.md (6). Tables are read-only. All numbers are double.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CURRENT_TABLE_H
#define FIELDMAP_CURRENT_TABLE_H

#include <stddef.h>

#include "division.h"
#include "real.h"

/* Status of the weights of a table. FOUND: interpolated. BESIDE: the currents do not belong to any signals. BEYOND: the
 * signals lie outside the table, or the current of a coil exceeds the limit. */
enum { FIELDMAP_TABLE_FOUND = 0, FIELDMAP_TABLE_BESIDE = 48, FIELDMAP_TABLE_BEYOND = 49 };

/* exponent: n of the division; limit: largest current of a coil, A, or infinity; mismatch: allowed difference between the
 * currents and the currents of their signals, as a share of u; lower, upper: range of u, x, y. sizes: numbers of nodes for u,
 * x, y; fields: number of weights. nodes: for u, x, y; knots: of the splines, four more than nodes, the first four and the last
 * four equal. coefficients (sizes, fields): of the splines; slopes (sizes, 6, fields): d weights / d currents at the nodes,
 * 1/A, or NULL for weights that are constant outside. */
typedef struct fieldmap_current_table {
    double exponent, limit, mismatch, lower[3], upper[3];
    int sizes[3], fields;
    const double *knots[3], *nodes[3], *coefficients, *slopes;
} fieldmap_current_table;

/* Fill value[4] with the cubic basis functions that are not zero at v. Returns the index of the first one. */
static inline int fieldmap_spline_basis(const double *knots, int count, double v, double value[4])
{
    const double *t;
    double share, p, q, a, b, c;
    int span = 3;
    while (span < count - 1 && v >= knots[span + 1]) span++;
    /* t[2] <= v < t[3]; t[0] to t[5] are the knots that the recurrence uses. */
    t = knots + span - 2;
    share = 1.0 / (t[3] - t[2]);
    p = (t[3] - v) * share / (t[3] - t[1]), q = (v - t[2]) * share / (t[4] - t[2]);
    a = (t[3] - v) * p / (t[3] - t[0]);
    b = ((v - t[1]) * p + (t[4] - v) * q) / (t[4] - t[1]);
    c = (v - t[2]) * q / (t[5] - t[2]);
    value[0] = (t[3] - v) * a;
    value[1] = (v - t[0]) * a + (t[4] - v) * b;
    value[2] = (v - t[1]) * b + (t[5] - v) * c;
    value[3] = (v - t[2]) * c;
    return span - 3;
}

/* Fill weights[fields] with the spline at signals[3]: the sum of 64 coefficients times the basis functions. */
static inline void fieldmap_table_sum(const fieldmap_current_table *table, const double *signals, double *FIELDMAP_RESTRICT weights)
{
    const int n = table->fields;
    double in[3][4];
    int first[3], a, b, k;
    for (k = 0; k < 3; k++) first[k] = fieldmap_spline_basis(table->knots[k], table->sizes[k], signals[k], in[k]);
    for (k = 0; k < n; k++) weights[k] = 0.0;
    for (a = 0; a < 4; a++)
        for (b = 0; b < 4; b++) {
            const size_t column = (size_t)(first[0] + a) * (size_t)table->sizes[1] + (size_t)(first[1] + b);
            const double *rows = table->coefficients + (column * (size_t)table->sizes[2] + (size_t)first[2]) * (size_t)n;
            const double share = in[0][a] * in[1][b];
            const double p = share * in[2][0], q = share * in[2][1], r = share * in[2][2], s = share * in[2][3];
            for (k = 0; k < n; k++) weights[k] += p * rows[k] + q * rows[n + k] + r * rows[2 * n + k] + s * rows[3 * n + k];
        }
}

/* Index of the cell of nodes that contains v. share: position of v in it, from 0 to 1. */
static inline int fieldmap_table_cell(const double *nodes, int count, double v, double *share)
{
    int i = 0;
    while (i < count - 2 && v >= nodes[i + 1]) i++;
    *share = (v - nodes[i]) / (nodes[i + 1] - nodes[i]);
    return i;
}

/* Add to weights[fields] the slopes at signals[3], interpolated trilinearly, times off[6], the difference between the currents
 * and the currents of the signals. */
static inline void fieldmap_table_add_slopes(
    const fieldmap_current_table *table, const double *signals, const double *off, double *FIELDMAP_RESTRICT weights)
{
    const int n = table->fields;
    double upper[3];
    int cell[3], corner, c, k;
    for (k = 0; k < 3; k++) cell[k] = fieldmap_table_cell(table->nodes[k], table->sizes[k], signals[k], upper + k);
    for (corner = 0; corner < 8; corner++) {
        size_t node = 0;
        double share = 1.0;
        for (k = 0; k < 3; k++) {
            const int end = corner >> (2 - k) & 1;
            node = node * (size_t)table->sizes[k] + (size_t)(cell[k] + end);
            share *= end ? upper[k] : 1.0 - upper[k];
        }
        for (c = 0; c < 6; c++) {
            const double *slope = table->slopes + (node * 6 + (size_t)c) * (size_t)n, step = share * off[c];
            for (k = 0; k < n; k++) weights[k] += step * slope[k];
        }
    }
}

/* Fill weights[6 + fields] at currents[6]: the currents themselves, then the weights of the table. Returns one of the statuses
 * above. If a current is NaN, so are the weights of the table, and the status is BEYOND. */
static inline int fieldmap_table_weights(const fieldmap_current_table *table, const double *currents, double *weights)
{
    double *iron = weights + 6, signals[3], within[3], largest = 0.0;
    const double worst = fieldmap_division_signals(currents, table->exponent, signals);
    int inside = 1, status, k;
    for (k = 0; k < 3; k++) {
        within[k] = fmin(fmax(signals[k], table->lower[k]), table->upper[k]);
        inside = inside && within[k] == signals[k];
    }
    for (k = 0; k < 6; k++) {
        weights[k] = currents[k];
        largest = fmax(largest, fabs(currents[k]));
    }
    if (!inside) status = FIELDMAP_TABLE_BEYOND;
    else if (worst > table->mismatch) status = FIELDMAP_TABLE_BESIDE;
    else status = largest > table->limit ? FIELDMAP_TABLE_BEYOND : FIELDMAP_TABLE_FOUND;
    fieldmap_table_sum(table, within, iron);
    if (status != FIELDMAP_TABLE_FOUND) {
        double off[6];
        fieldmap_divide(within[0], within[1], within[2], table->exponent, off);
        for (k = 0; k < 6; k++) off[k] = currents[k] - off[k];
        if (table->slopes != NULL) fieldmap_table_add_slopes(table, within, off, iron);
        for (k = 0; k < table->fields && !(signals[0] == signals[0]); k++) iron[k] = signals[0];
    }
    return status;
}

#endif
