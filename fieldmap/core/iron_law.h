/* iron_law.h: polarisation of iron at one point, without hysteresis and with play cells (docs/theory/hysteresis.md).
 *
 * Fields are in T: h = mu0 H, b = h + J. Cells have pinning fields and remember reversible fields. Nothing here allocates.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_IRON_LAW_H
#define FIELDMAP_IRON_LAW_H

#include <math.h>

enum { FIELDMAP_CELL_TURNS = 12, FIELDMAP_CELL_STEPS = 60 };

/* The anhysteretic law b(h) of one material: cubics that begin at knots[low..high], in ascending order. The last one is a
 * straight line. piece of the functions below keeps the interval of the knots for the next call. */
typedef struct fieldmap_iron_curve {
    const double *knots, *coefficients;
    int low, high;
} fieldmap_iron_curve;

/* b at field strength h >= 0; slope: db/dh. */
static inline double fieldmap_iron_law(const fieldmap_iron_curve *of, int *piece, double h, double *slope)
{
    const double *knots = of->knots, *c;
    double t, c0, c1;
    int j = *piece;
    if (!(knots[j] <= h && (j == of->high || h < knots[j + 1]))) {
        int above = of->high;
        j = of->low;
        while (above - j > 1) {
            int middle = (j + above) / 2;
            if (knots[middle] <= h)
                j = middle;
            else
                above = middle;
        }
        if (h >= knots[of->high]) j = of->high;
        *piece = j;
    }
    t = h - knots[j];
    c = of->coefficients + 4 * (size_t)j;
    c0 = j == of->high ? 0.0 : c[0], c1 = j == of->high ? 0.0 : c[1];
    *slope = (3.0 * c0 * t + 2.0 * c1) * t + c[2];
    return ((c0 * t + c1) * t + c[2]) * t + c[3];
}

/* J / s at s = |h|, where J is the anhysteretic polarisation; slope: dJ/ds. */
static inline double fieldmap_iron_chord(const fieldmap_iron_curve *of, int *piece, double s, double *slope)
{
    const double j = fieldmap_iron_law(of, piece, s, slope) - s;
    *slope -= 1.0;
    return s > 1e-30 ? j / s : *slope;
}

/* Entries xx, xy, xz, yy, yz, zz of the matrix `across` + `along` v v^T. */
static inline void fieldmap_symmetric(double across, double along, const double *v, double *out)
{
    out[0] = across + along * v[0] * v[0], out[1] = along * v[0] * v[1], out[2] = along * v[0] * v[2];
    out[3] = across + along * v[1] * v[1], out[4] = along * v[1] * v[2], out[5] = across + along * v[2] * v[2];
}

static inline double fieldmap_norm(const double *v)
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* s >= 0 with J(s) + mu s = wanted: Newton's method between two bounds. */
static inline double fieldmap_cell_drawn(const fieldmap_iron_curve *of, int *piece, double wanted, double mu, double s)
{
    double low = 0.0, high = (double)INFINITY;
    int k;
    for (k = 0; k < FIELDMAP_CELL_STEPS; k++) {
        double slope, next, rest = fieldmap_iron_law(of, piece, s, &slope) - s + mu * s - wanted;
        if (fabs(rest) <= 1e-15 * wanted) break;
        if (rest > 0.0)
            high = s;
        else
            low = s;
        next = s - rest / (slope - 1.0 + mu);
        if (!(low <= next && next <= high)) next = high < (double)INFINITY ? 0.5 * (low + high) : 2.0 * low;
        if (next == s) break;
        s = next;
    }
    return s;
}

/* As fieldmap_cell_moved, by a search for mu between bounds: 1 / |h - r| is nearly linear in mu. j: polarisation of the cell;
 * r: the field straight towards h, to begin with. */
static inline double fieldmap_cell_bounded(
    const fieldmap_iron_curve *of, int *piece, const double *h, const double *j, double kappa, double *r)
{
    double low = 0.0, high = (double)INFINITY, s = fieldmap_norm(r), slope, mu, d[3], q[3];
    double chord = fieldmap_iron_chord(of, piece, s, &slope);
    int i, k;
    for (i = 0; i < 3; i++) d[i] = chord * r[i] - j[i];
    mu = fmax(fieldmap_norm(d) / kappa, 1e-13);
    for (k = 0; k < FIELDMAP_CELL_STEPS; k++) {
        double size, away, along, pull, next;
        for (i = 0; i < 3; i++) q[i] = j[i] + mu * h[i];
        size = fieldmap_norm(q);
        s = size < 1e-30 ? 0.0 : fieldmap_cell_drawn(of, piece, size, mu, s);
        for (i = 0; i < 3; i++) {
            r[i] = size < 1e-30 ? 0.0 : s / size * q[i];
            d[i] = h[i] - r[i];
        }
        away = fieldmap_norm(d);
        if (fabs(away - kappa) <= 1e-12 * kappa || mu <= 1e-13) break;
        if (away > kappa)
            low = mu;
        else
            high = mu;
        chord = fieldmap_iron_chord(of, piece, s, &slope);
        along = s > 1e-30 ? (d[0] * r[0] + d[1] * r[1] + d[2] * r[2]) / s : 0.0;
        pull = (away * away - along * along) / (chord + mu) + along * along / (slope + mu);
        next = mu + (1.0 / kappa - 1.0 / away) * away * away * away / pull;
        if (!(low < next && next < high)) next = high < (double)INFINITY ? 0.5 * (low + high) : 4.0 * mu;
        if (fabs(next - mu) <= 1e-15 * mu) break;
        mu = fmax(next, 1e-13);
    }
    return mu;
}

/* Fill the reversible field r[3] of a cell in the field h, from the remembered p[4], and return mu of (2): 0 where the cell
 * stays, infinity without pinning. A cell remembers its field and the ratio of its polarisation to it. r lies on the circle of
 * radius kappa about h, in the plane of h and p. Newton's method turns the direction n of h - r, which begins straight towards
 * h, until J(r) - J(p) points along it. */
static inline double fieldmap_cell_moved(
    const fieldmap_iron_curve *of, int *piece, const double *h, const double *p, double kappa, double *r)
{
    double u[3], v[3], j[3], away, chord, slope, h_u, h_v, n_u = 1.0, n_v = 0.0;
    int i, k;
    for (i = 0; i < 3; i++) r[i] = kappa == 0.0 ? h[i] : p[i];
    if (kappa == 0.0) return (double)INFINITY;
    for (i = 0; i < 3; i++) u[i] = h[i] - p[i];
    away = fieldmap_norm(u);
    if (away <= kappa) return 0.0;
    /* u: unit vector from p to h; v: across, in the plane of both. */
    for (i = 0; i < 3; i++) u[i] /= away;
    h_u = h[0] * u[0] + h[1] * u[1] + h[2] * u[2];
    for (i = 0; i < 3; i++) v[i] = h[i] - h_u * u[i];
    h_v = fieldmap_norm(v);
    for (i = 0; i < 3; i++) v[i] = h_v > 0.0 ? v[i] / h_v : 0.0;
    chord = p[3];
    for (i = 0; i < 3; i++) j[i] = chord * p[i];
    for (k = 0; k < FIELDMAP_CELL_TURNS; k++) {
        const double r_u = h_u - kappa * n_u, r_v = h_v - kappa * n_v, s = sqrt(r_u * r_u + r_v * r_v);
        double of_r = fieldmap_iron_chord(of, piece, s, &slope), g_u, g_v, along, across, t, angle, size;
        g_u = of_r * r_u - chord * (h_u - away), g_v = of_r * r_v - chord * h_v;
        along = g_u * n_u + g_v * n_v, across = g_v * n_u - g_u * n_v;
        if (along <= 0.0) break;
        t = s > 1e-30 ? (r_v * n_u - r_u * n_v) / s : 0.0;
        angle = across / (along + kappa * (of_r + (slope - of_r) * t * t));
        if (fabs(angle) <= 1e-13) {
            for (i = 0; i < 3; i++) r[i] = r_u * u[i] + r_v * v[i];
            return fmax(along / kappa, 1e-13);
        }
        angle = fmin(fmax(angle, -0.5), 0.5);
        t = n_u - angle * n_v, n_v = n_v + angle * n_u, n_u = t;
        size = sqrt(n_u * n_u + n_v * n_v);
        n_u /= size, n_v /= size;
    }
    for (i = 0; i < 3; i++) r[i] = h[i] - kappa * u[i];
    return fieldmap_cell_bounded(of, piece, h, j, kappa, r);
}

/* Polarisation j[3] of `cells` cells in the field h. shares: their weights, with the sum 1. before, after: what they remember,
 * and would (4 numbers each, as of fieldmap_cell_moved); susceptible: dJ/dh, entries xx, xy, xz, yy, yz, zz. after and
 * susceptible may be NULL. Equations (1) and (4). */
static inline void fieldmap_cells_respond(const fieldmap_iron_curve *of, int *piece, int cells, const double *pinning,
    const double *shares, const double *h, const double *before, double *j, double *after, double *susceptible)
{
    int i, k;
    for (i = 0; i < 3; i++) j[i] = 0.0;
    for (i = 0; i < 6 && susceptible != NULL; i++) susceptible[i] = 0.0;
    for (k = 0; k < cells; k++) {
        double r[3], e[3], n[3], part[6], slope = 0.0, chord = before[4 * k + 3], s = 0.0, across, along, push, dot;
        const double mu = fieldmap_cell_moved(of, piece, h, before + 4 * k, pinning[k], r);
        if (mu > 0.0) {
            s = fieldmap_norm(r);
            chord = fieldmap_iron_chord(of, piece, s, &slope);
        }
        for (i = 0; i < 3; i++) j[i] += shares[k] * chord * r[i];
        for (i = 0; i < 3 && after != NULL; i++) after[4 * k + i] = r[i];
        if (after != NULL) after[4 * k + 3] = chord;
        if (mu == 0.0 || susceptible == NULL) continue;
        for (i = 0; i < 3; i++) e[i] = s > 1e-30 ? r[i] / s : 0.0;
        across = chord, along = slope - chord;
        if (mu < (double)INFINITY) {
            const double c = chord / (chord + mu), difference = slope / (slope + mu) - c;
            across = mu * c, along = mu * difference;
            for (i = 0; i < 3; i++) n[i] = (h[i] - r[i]) / pinning[k];
            dot = n[0] * e[0] + n[1] * e[1] + n[2] * e[2];
            push = 1.0 / ((1.0 - dot * dot) / (chord + mu) + dot * dot / (slope + mu));
            for (i = 0; i < 3; i++) n[i] = c * n[i] + difference * dot * e[i];
            fieldmap_symmetric(0.0, push, n, part);
            for (i = 0; i < 6; i++) susceptible[i] += shares[k] * part[i];
        }
        fieldmap_symmetric(across, along, e, part);
        for (i = 0; i < 6; i++) susceptible[i] += shares[k] * part[i];
    }
}

/* Heat of a step of `cells` cells for each volume, times mu0, T^2: share and pinning field of each times the distance by which
 * its polarisation moved. before, after: as for fieldmap_cells_respond. The integrand of equation (5). */
static inline double fieldmap_cells_heat(
    int cells, const double *pinning, const double *shares, const double *before, const double *after)
{
    double heat = 0.0, way[3];
    int i, k;
    for (k = 0; k < cells; k++) {
        const double *p = before + 4 * k, *r = after + 4 * k;
        if (r[0] == p[0] && r[1] == p[1] && r[2] == p[2]) continue;
        for (i = 0; i < 3; i++) way[i] = r[3] * r[i] - p[3] * p[i];
        heat += shares[k] * pinning[k] * fieldmap_norm(way);
    }
    return heat;
}

#endif
