/* Goes along a path of currents in a map of iron with hysteresis, and prints what it finds as hexadecimal numbers.
 *
 * remember MAP ROWS FROM TO STORED: rows of currents, other currents, point and moment, of which those from FROM to TO are
 * gone. A line has the flux density at the other currents, asked before the step, and flux density, gradient and wrench after
 * it. The memory comes from the file STORED unless FROM is 0, and goes there at the end.
 * remember MAP: the status of opening it and of a step.
 */
#include "fieldmap_iron.h"

static double memory[1 << 18], stored[1 << 17], before[1 << 17], row[64];

static void print(const double *values, int count)
{
    int i;
    for (i = 0; i < count; i++) printf("%a ", values[i]);
}

/* Whether a file has exactly this many numbers, which are read. */
static int read_all(const char *path, double *out, size_t count)
{
    FILE *file = fopen(path, "rb");
    const int good = file != NULL && fread(out, sizeof(double), count + 1, file) == count;
    if (file != NULL) fclose(file);
    return good;
}

int main(int argc, char **argv)
{
    fieldmap_iron map;
    fieldmap_iron_state state;
    void *place = (void *)(((uintptr_t)memory + 63) / 64 * 64);
    FILE *rows, *out;
    size_t c, count;
    long k, from, to;
    double flux[3], gradient[9], wrench[6];
    int status = fieldmap_iron_open(&map, argv[1]);
    if (status == FIELDMAP_OK) status = fieldmap_iron_start(&state, &map, place, sizeof memory - 64);
    if (argc < 6) {
        if (status == FIELDMAP_OK) {
            printf("opened, ");
            for (k = 0; k < map.n_coils && k < 64; k++) row[k] = 0.7;
            if (map.n_coils <= 64) status = fieldmap_iron_step(&state, row);
        }
        printf("%s\n", fieldmap_iron_message(status));
        fieldmap_iron_close(&map);
        return 0;
    }
    if (status != FIELDMAP_OK) return 2;
    c = (size_t)map.n_coils, count = fieldmap_iron_copy(&state, NULL, NULL);
    from = atol(argv[3]), to = atol(argv[4]);
    if (count + 1 > sizeof stored / sizeof *stored || 2 * c + 6 > 64) return 3;
    if (from > 0) {
        if (!read_all(argv[5], stored, count)) return 4;
        fieldmap_iron_copy(&state, NULL, stored);
    }
    rows = fopen(argv[2], "rb");
    if (rows == NULL) return 5;
    for (k = 0; k < to && fread(row, sizeof(double), 2 * c + 6, rows) == 2 * c + 6; k++) {
        const double *point = row + 2 * c;
        if (k < from) continue;
        /* Steps and lookups of Python have these tolerances, and lookups leave no trace there. */
        fieldmap_iron_copy(&state, before, NULL);
        state.tolerance = 5e-7;
        if (fieldmap_iron_field(&state, row + c, point, flux, NULL) != FIELDMAP_OK) return 6;
        print(flux, 3);
        fieldmap_iron_copy(&state, NULL, before);
        state.tolerance = map.tolerance;
        if (fieldmap_iron_step(&state, row) != FIELDMAP_OK) return 7;
        if (fieldmap_iron_field(&state, row, point, flux, gradient) != FIELDMAP_OK) return 8;
        if (fieldmap_iron_wrench(&state, row, point, point + 3, wrench) != FIELDMAP_OK) return 9;
        print(flux, 3), print(gradient, 9), print(wrench, 6);
        printf("\n");
    }
    fclose(rows);
    fieldmap_iron_copy(&state, stored, NULL);
    out = fopen(argv[5], "wb");
    if (out == NULL || fwrite(stored, sizeof(double), count, out) != count || fclose(out) != 0) return 10;
    fieldmap_iron_close(&map);
    return 0;
}
