/* iron_law.h: polarisation of iron at one point, without hysteresis and with play cells (docs/theory/hysteresis.md).
 *
 * Fields are in T: h = mu0 H, b = h + J. Play cells have pinning fields and remember reversible fields. Nothing allocates.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_IRON_LAW_H
#define FIELDMAP_IRON_LAW_H

#include <math.h>

enum { FIELDMAP_CELL_TURNS = 12, FIELDMAP_CELL_STEPS = 60, FIELDMAP_CELL_LANES = 8 };

/* The anhysteretic law b(h) of one material: cubics that begin at knots[low..high], in ascending order. The last cubic is a
 * straight line. The functions below keep the interval of the knots in `piece` for the next call. */
typedef struct fieldmap_iron_curve {
    const double *knots, *coefficients;
    int low, high;
} fieldmap_iron_curve;

/* Move piece to the interval of the knots in which h >= 0 lies. */
static inline void fieldmap_iron_find(const fieldmap_iron_curve *of, int *piece, double h)
{
    const double *knots = of->knots;
    int j = *piece, above = of->high;
    if (knots[j] <= h && (j == of->high || h < knots[j + 1])) return;
    j = of->low;
    while (above - j > 1) {
        int middle = (j + above) / 2;
        if (knots[middle] <= h)
            j = middle;
        else
            above = middle;
    }
    *piece = h >= knots[of->high] ? of->high : j;
}

/* b at field strength h >= 0; slope: db/dh. */
static inline double fieldmap_iron_law(const fieldmap_iron_curve *of, int *piece, double h, double *slope)
{
    const double *c;
    double t, c0, c1;
    fieldmap_iron_find(of, piece, h);
    t = h - of->knots[*piece];
    c = of->coefficients + 4 * (size_t)*piece;
    c0 = *piece == of->high ? 0.0 : c[0], c1 = *piece == of->high ? 0.0 : c[1];
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
 * r: first guess, the field straight towards h. */
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

/* Cells that move to a new reversible field r, one in each lane. A cell remembers its field p and the ratio of its polarisation
 * to it. r lies on the circle of radius kappa about h, in the plane of h and p. The axes of the plane are u, the direction from
 * p to h, and v. away: distance from p to h. step: h - p. n: direction of h - r. mu: as in (2), 0 until it is found; chord,
 * slope: J / |r| and dJ / d|r|. heat: of the cells that move and remember it, times mu0: (5). The other numbers are arguments
 * of fieldmap_cells_add. */
typedef struct fieldmap_cell_lanes {
    int count, piece[FIELDMAP_CELL_LANES], *known[FIELDMAP_CELL_LANES];
    double heat;
    double h[3][FIELDMAP_CELL_LANES], step[3][FIELDMAP_CELL_LANES], kappa[FIELDMAP_CELL_LANES], ratio[FIELDMAP_CELL_LANES];
    double u[3][FIELDMAP_CELL_LANES], v[3][FIELDMAP_CELL_LANES], away[FIELDMAP_CELL_LANES], h_u[FIELDMAP_CELL_LANES];
    double h_v[FIELDMAP_CELL_LANES], n_u[FIELDMAP_CELL_LANES], n_v[FIELDMAP_CELL_LANES], mu[FIELDMAP_CELL_LANES];
    double chord[FIELDMAP_CELL_LANES], slope[FIELDMAP_CELL_LANES], share[FIELDMAP_CELL_LANES];
    double *j[FIELDMAP_CELL_LANES], *after[FIELDMAP_CELL_LANES], *susceptible[FIELDMAP_CELL_LANES];
    const double *before[FIELDMAP_CELL_LANES];
    fieldmap_iron_curve of[FIELDMAP_CELL_LANES];
} fieldmap_cell_lanes;

/* Fill u, v and the places of h and p in their plane. Lanes beyond count repeat the first one. */
static inline void fieldmap_cells_frame(fieldmap_cell_lanes *s)
{
    int i, k;
    for (i = s->count; i < FIELDMAP_CELL_LANES; i++) {
        for (k = 0; k < 3; k++) s->h[k][i] = s->h[k][0], s->step[k][i] = s->step[k][0];
        s->kappa[i] = s->kappa[0], s->ratio[i] = s->ratio[0], s->of[i] = s->of[0], s->piece[i] = s->piece[0];
    }
    for (i = 0; i < FIELDMAP_CELL_LANES; i++) {
        const double x = s->step[0][i], y = s->step[1][i], z = s->step[2][i], away = sqrt(x * x + y * y + z * z);
        const double inverse = 1.0 / away, u_x = x * inverse, u_y = y * inverse, u_z = z * inverse;
        const double h_u = s->h[0][i] * u_x + s->h[1][i] * u_y + s->h[2][i] * u_z;
        const double v_x = s->h[0][i] - h_u * u_x, v_y = s->h[1][i] - h_u * u_y, v_z = s->h[2][i] - h_u * u_z;
        const double h_v = sqrt(v_x * v_x + v_y * v_y + v_z * v_z), across = 1.0 / (h_v > 1e-300 ? h_v : 1e-300);
        s->u[0][i] = u_x, s->u[1][i] = u_y, s->u[2][i] = u_z;
        s->v[0][i] = v_x * across, s->v[1][i] = v_y * across, s->v[2][i] = v_z * across;
        s->away[i] = away, s->h_u[i] = h_u, s->h_v[i] = h_v;
    }
}

/* Turn n, which begins at u, by Newton's method until J(r) - J(p) points along it. A lane that has converged does not change
 * any more, so that no cell depends on its neighbours. mu stays 0 where the method fails. */
static inline void fieldmap_cells_turn(fieldmap_cell_lanes *s)
{
    double open[FIELDMAP_CELL_LANES], left;
    int i, k;
    for (i = 0; i < FIELDMAP_CELL_LANES; i++)
        s->n_u[i] = open[i] = 1.0, s->n_v[i] = s->mu[i] = s->chord[i] = s->slope[i] = 0.0;
    for (k = 0, left = 1.0; k < FIELDMAP_CELL_TURNS && left > 0.0; k++) {
        double size[FIELDMAP_CELL_LANES], t[FIELDMAP_CELL_LANES], c[4][FIELDMAP_CELL_LANES];
        for (i = 0; i < FIELDMAP_CELL_LANES; i++) {
            const double r_u = s->h_u[i] - s->kappa[i] * s->n_u[i], r_v = s->h_v[i] - s->kappa[i] * s->n_v[i];
            size[i] = sqrt(r_u * r_u + r_v * r_v);
        }
        for (i = 0; i < FIELDMAP_CELL_LANES; i++) {
            const fieldmap_iron_curve *of = s->of + i;
            const double *row;
            fieldmap_iron_find(of, s->piece + i, size[i]);
            row = of->coefficients + 4 * (size_t)s->piece[i];
            t[i] = size[i] - of->knots[s->piece[i]];
            c[0][i] = s->piece[i] == of->high ? 0.0 : row[0], c[1][i] = s->piece[i] == of->high ? 0.0 : row[1];
            c[2][i] = row[2] - 1.0, c[3][i] = row[3];
        }
        left = 0.0;
        for (i = 0; i < FIELDMAP_CELL_LANES; i++) {
            const double kappa = s->kappa[i], n_u = s->n_u[i], n_v = s->n_v[i];
            const double r_u = s->h_u[i] - kappa * n_u, r_v = s->h_v[i] - kappa * n_v;
            const double inverse = 1.0 / (size[i] > 1e-30 ? size[i] : 1e-30);
            const double slope = (3.0 * c[0][i] * t[i] + 2.0 * c[1][i]) * t[i] + c[2][i];
            const double j = ((c[0][i] * t[i] + c[1][i]) * t[i] + c[2][i]) * t[i] + c[3][i] - (size[i] - t[i]);
            const double chord = size[i] > 1e-30 ? j * inverse : slope;
            const double g_u = chord * r_u - s->ratio[i] * (s->h_u[i] - s->away[i]), g_v = chord * r_v - s->ratio[i] * s->h_v[i];
            const double along = g_u * n_u + g_v * n_v, across = (r_v * n_u - r_u * n_v) * inverse;
            const double turn = (g_v * n_u - g_u * n_v) / (along + kappa * (chord + (slope - chord) * across * across));
            const double angle = turn < -0.5 ? -0.5 : turn > 0.5 ? 0.5 : turn;
            const double x = n_u - angle * n_v, y = n_v + angle * n_u, scale = 1.0 / sqrt(x * x + y * y);
            const double push = along / kappa;
            const double going = along > 0.0 ? open[i] : 0.0;
            /* Convergence is quadratic: the next angle would be about the square of this one. */
            const double found = fabs(angle) <= 1e-8 ? going : 0.0;
            s->n_u[i] = going > 0.0 ? x * scale : n_u, s->n_v[i] = going > 0.0 ? y * scale : n_v;
            s->mu[i] = found > 0.0 ? (push > 1e-13 ? push : 1e-13) : s->mu[i];
            s->chord[i] = found > 0.0 ? chord - (slope - chord) * kappa * angle * across * inverse : s->chord[i];
            s->slope[i] = found > 0.0 ? slope : s->slope[i];
            open[i] = going - found;
            left += open[i];
        }
    }
}

/* Add a cell with the reversible field r and mu of (2) to j[3] and, unless NULL, dJ/dh; fill its memory `after` unless NULL. */
static inline void fieldmap_cell_moved(double share, const double *h, const double *r, double kappa, double mu, double chord,
    double slope, double *j, double *after, double *susceptible)
{
    double e[3], n[3], part[6], across = chord, along = slope - chord, size;
    int i;
    for (i = 0; i < 3; i++) j[i] += share * chord * r[i];
    for (i = 0; i < 3 && after != NULL; i++) after[i] = r[i];
    if (after != NULL) after[3] = chord;
    if (susceptible == NULL) return;
    size = fieldmap_norm(r);
    for (i = 0; i < 3; i++) e[i] = size > 1e-30 ? r[i] / size : 0.0;
    if (kappa > 0.0) {
        const double c = chord / (chord + mu), difference = slope / (slope + mu) - c;
        double push, dot;
        across = mu * c, along = mu * difference;
        for (i = 0; i < 3; i++) n[i] = (h[i] - r[i]) / kappa;
        dot = n[0] * e[0] + n[1] * e[1] + n[2] * e[2];
        push = 1.0 / ((1.0 - dot * dot) / (chord + mu) + dot * dot / (slope + mu));
        for (i = 0; i < 3; i++) n[i] = c * n[i] + difference * dot * e[i];
        fieldmap_symmetric(0.0, push, n, part);
        for (i = 0; i < 6; i++) susceptible[i] += share * part[i];
    }
    fieldmap_symmetric(across, along, e, part);
    for (i = 0; i < 6; i++) susceptible[i] += share * part[i];
}

/* Find and add the cells that wait in the lanes. */
static inline void fieldmap_cells_finish(fieldmap_cell_lanes *s)
{
    int i, k;
    if (s->count == 0) return;
    fieldmap_cells_frame(s);
    fieldmap_cells_turn(s);
    for (k = 0; k < s->count; k++) {
        const double *p = s->before[k], kappa = s->kappa[k], h[3] = {s->h[0][k], s->h[1][k], s->h[2][k]};
        const double r_u = s->h_u[k] - kappa * s->n_u[k], r_v = s->h_v[k] - kappa * s->n_v[k];
        double r[3], j[3];
        for (i = 0; i < 3; i++) r[i] = r_u * s->u[i][k] + r_v * s->v[i][k];
        if (s->mu[k] == 0.0) {
            for (i = 0; i < 3; i++) r[i] = h[i] - kappa * s->u[i][k], j[i] = p[3] * p[i];
            s->mu[k] = fieldmap_cell_bounded(s->of + k, s->piece + k, h, j, kappa, r);
            s->chord[k] = fieldmap_iron_chord(s->of + k, s->piece + k, fieldmap_norm(r), s->slope + k);
        }
        if (s->after[k] != NULL) {
            for (i = 0; i < 3; i++) j[i] = s->chord[k] * r[i] - p[3] * p[i];
            s->heat += s->share[k] * kappa * fieldmap_norm(j);
        }
        fieldmap_cell_moved(s->share[k], h, r, kappa, s->mu[k], s->chord[k], s->slope[k], s->j[k], s->after[k], s->susceptible[k]);
        if (s->known[k] != NULL) *s->known[k] = s->piece[k];
    }
    s->count = 0;
}

/* Whether a cell that remembers p[3] stays in the field h[3] of this size. The margin covers rounding: a cell that has just
 * moved in this field lies at the distance kappa. */
static inline int fieldmap_cell_stays(const double *h, const double *p, double kappa, double size)
{
    const double x = h[0] - p[0], y = h[1] - p[1], z = h[2] - p[2], reach = kappa + 1e-15 * (size + kappa);
    return x * x + y * y + z * z <= reach * reach;
}

/* Begin j[3], `weight` times the polarisation of `cells` cells in the field h, and fill it by fieldmap_cells_finish. shares:
 * their weights, with the sum 1. before, after: memory of the cells now and in the field h, 4 numbers each: reversible field,
 * and ratio of the polarisation to it. susceptible: weight dJ/dh, entries xx, xy, xz, yy, yz, zz. piece: for each cell. after,
 * susceptible and piece may be NULL; after may be before. Equations (1) and (4). */
static inline void fieldmap_cells_add(fieldmap_cell_lanes *moving, const fieldmap_iron_curve *of, int *piece, int cells,
    const double *pinning, const double *shares, double weight, const double *h, const double *before, double *j, double *after,
    double *susceptible)
{
    const double size = fieldmap_norm(h);
    int i, k;
    for (i = 0; i < 3; i++) j[i] = 0.0;
    for (i = 0; i < 6 && susceptible != NULL; i++) susceptible[i] = 0.0;
    /* Cells that need no lane come first, so that the order of a sum does not depend on the filling of the lanes. */
    for (k = 0; k < cells; k++) {
        const double share = weight * shares[k], *p = before + 4 * k;
        double *then = after == NULL ? NULL : after + 4 * k;
        if (pinning[k] == 0.0) {
            int at = piece == NULL ? of->low : piece[k];
            double slope, chord = fieldmap_iron_chord(of, &at, size, &slope);
            fieldmap_cell_moved(share, h, h, 0.0, 0.0, chord, slope, j, then, susceptible);
            if (piece != NULL) piece[k] = at;
        } else if (fieldmap_cell_stays(h, p, pinning[k], size)) {
            for (i = 0; i < 3; i++) j[i] += share * p[3] * p[i];
            for (i = 0; i < 4 && then != NULL; i++) then[i] = p[i];
        }
    }
    for (k = 0; k < cells; k++) {
        const double *p = before + 4 * k;
        const int m = moving->count;
        if (pinning[k] == 0.0 || fieldmap_cell_stays(h, p, pinning[k], size)) continue;
        for (i = 0; i < 3; i++) moving->h[i][m] = h[i], moving->step[i][m] = h[i] - p[i];
        moving->kappa[m] = pinning[k], moving->ratio[m] = p[3], moving->share[m] = weight * shares[k];
        moving->before[m] = p, moving->j[m] = j, moving->susceptible[m] = susceptible;
        moving->after[m] = after == NULL ? NULL : after + 4 * k;
        moving->known[m] = piece == NULL ? NULL : piece + k;
        moving->of[m] = *of, moving->piece[m] = piece == NULL ? of->low : piece[k];
        if (++moving->count == FIELDMAP_CELL_LANES) fieldmap_cells_finish(moving);
    }
}

#endif
