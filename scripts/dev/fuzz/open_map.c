/* open_map: bytes that may be a map of fieldmap.h or fieldmap_iron.h, opened and, where they are accepted, asked.
 *
 * scripts/dev/fuzz_core.py builds this for libFuzzer, which calls LLVMFuzzerTestOneInput. With OPEN_MAP_MAIN it is a program
 * that reads files, for AFL++ and for looking at a finding again:
 *
 *     afl-clang-fast -DOPEN_MAP_MAIN -fsanitize=address,undefined -I fieldmap/core scripts/dev/fuzz/open_map.c -lm -o open_map
 *     afl-fuzz -i seeds -o out ./open_map @@
 *
 * The bytes are opened as they are from a file, and in memory with sizes and checksums that fit: else hardly any change
 * would come past the checksum. Memory has the size of the bytes, so that a sanitizer sees what is read behind them.
 */
#define _POSIX_C_SOURCE 200112L

#include "fieldmap_iron.h"

#include <stdint.h>
#include <unistd.h>

/* Most numbers of rows times modes that are solved: a solve of more would take seconds under sanitizers. */
#define MOST_WORK 200000.0

enum { POINTS = 7 };

static long accepted, solved;

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

/* Memory, which there must be: what is asked for is as large as the input, about. */
static void *taken(size_t size)
{
    void *memory = NULL;
    if (posix_memalign(&memory, 64, size > 0 ? size : 1) != 0) _exit(77);
    return memory;
}

/* Corners of the box, its middle, points out of it, and what is no point. */
static void choose_points(const fieldmap *map, double points[3 * POINTS])
{
    int i;
    for (i = 0; i < 3; i++) {
        const double low = map->lower[i], high = map->upper[i];
        points[i] = low;
        points[3 + i] = high;
        points[6 + i] = low + 0.5 * (high - low);
        points[9 + i] = low + (0.2 + 0.3 * i) * (high - low);
        points[12 + i] = high + 1.0;
        points[15 + i] = i == 1 ? -1e308 : 1e308;
        points[18 + i] = i == 2 ? (double)NAN : low;
    }
}

/* Everything that a map can be asked. weights: NULL for a map of one set. */
static void ask_fields(const fieldmap *map, const double *weights)
{
    const double moment[3] = {0.3, -0.2, 1.0};
    double points[3 * POINTS], flux[3 * POINTS], gradient[9 * POINTS], second[27], wrench[6], potential;
    int p;
    choose_points(map, points);
    for (p = 0; p < POINTS; p++) {
        const double *point = points + 3 * p;
        fieldmap_field(map, weights, point, flux, NULL);
        fieldmap_field(map, weights, point, flux, gradient);
        fieldmap_second_gradient(map, weights, point, second);
        fieldmap_wrench(map, weights, point, moment, wrench);
        if (fieldmap_check(map, weights, point) == FIELDMAP_OK)
            fieldmap_potential_of_weights(map, weights, point, &potential);
    }
    if (fieldmap_check(map, weights, points) == FIELDMAP_OK)
        fieldmap_fields(map, weights, 0, points, POINTS, flux, gradient);
}

static void ask_map(const fieldmap *map)
{
    const size_t coils = (size_t)map->n_coils;
    double *currents = (double *)taken(coils * sizeof(double));
    fieldmap fixed;
    size_t k, length = 0;
    accepted++;
    for (k = 0; k < coils; k++) {
        const char *name = fieldmap_coil_name(map, (int)k);
        currents[k] = 0.5 - (double)(k % 3);
        if (name != NULL && k < 64) length += strlen(name);
    }
    if (length == (size_t)-1) _exit(78);
    ask_fields(map, currents);
    if (fieldmap_sets(map) == 1) ask_fields(map, NULL);
    if (fieldmap_at(map, currents, &fixed) == FIELDMAP_OK) {
        ask_fields(&fixed, NULL);
        fieldmap_close(&fixed);
    }
    free(currents);
}

/* Currents of case `number`: in the middle of the domain, none, near the middle, opposed, far too large, not finite. */
static void choose_currents(const fieldmap_iron *map, int number, double *currents)
{
    static const double shares[] = {0.5, 0.0, 0.52, -0.4, 1e6, 1e300};
    const double share = shares[number % 6];
    int k, j;
    for (k = 0; k < map->n_coils; k++) {
        currents[k] = share * (1.0 + 0.01 * (double)(k % 7));
        if (map->division || share != 0.5) continue;
        currents[k] = 0.0;
        for (j = 0; j < map->n_signals; j++)
            currents[k] += map->matrix[(size_t)k * (size_t)map->n_signals + (size_t)j] * 0.5 * (map->lower[j] + map->upper[j]);
    }
    if (map->division && share == 0.5) fieldmap_divide(0.5 * (map->lower[0] + map->upper[0]), 0.1, -0.1, map->exponent, currents);
    if (number == 6) currents[map->n_coils - 1] = (double)NAN;
}

static void ask_iron(const fieldmap_iron *map)
{
    const size_t coils = (size_t)map->n_coils, fields = (size_t)map->n_fields, size = fieldmap_iron_memory(map);
    const double moment[3] = {0.3, -0.2, 1.0};
    double points[3 * POINTS], flux[3], gradient[9], wrench[6], *memory, *currents, *weights, *slopes;
    fieldmap_iron_state state;
    int number, p, checked;
    accepted++;
    if (3.0 * map->p * map->wide * map->r > MOST_WORK || map->n_terms > 2000) return;
    memory = (double *)taken(size);
    currents = (double *)taken(coils * sizeof(double));
    weights = (double *)taken(fields * sizeof(double));
    slopes = (double *)taken(fields * coils * sizeof(double));
    choose_points(&map->fields, points);
    /* As the map says, and with currents out of its domain let through. */
    for (checked = 1; checked >= 0; checked--) {
        if (fieldmap_iron_start(&state, map, memory, size) != FIELDMAP_OK) _exit(79);
        if (!checked) state.checked = 0;
        for (number = 0; number < 7; number++) {
            choose_currents(map, number, currents);
            for (p = 0; p < POINTS; p++) {
                fieldmap_iron_field(&state, currents, points + 3 * p, flux, p % 2 ? gradient : NULL);
                fieldmap_iron_wrench(&state, currents, points + 3 * p, moment, wrench);
                /* What did not converge is solved anew for every point. */
                if (state.count == 0) break;
            }
            solved += fieldmap_iron_weights(&state, currents, weights) == FIELDMAP_OK;
            fieldmap_iron_slopes(&state, currents, weights, slopes);
            fieldmap_iron_follow(&state, currents);
        }
    }
    free(slopes);
    free(weights);
    free(currents);
    free(memory);
}

/* Size and checksum of a file of fieldmap that begins here. */
static void repair(unsigned char *raw, size_t size)
{
    const uint64_t total = size;
    uint32_t crc;
    memcpy(raw + 16, &total, 8);
    crc = fieldmap_checksum(raw + 28, size - 28);
    memcpy(raw + 24, &crc, 4);
}

/* In memory, with sizes and checksums that fit, those of the fields of a saturating map as well. */
static void view(const uint8_t *bytes, size_t size)
{
    unsigned char *copy;
    fieldmap map;
    fieldmap_iron iron;
    uint64_t count;
    if (size < FIELDMAP_NAMES) return;
    copy = (unsigned char *)taken(size);
    memcpy(copy, bytes, size);
    memcpy(&count, copy + 32, 8);
    if (memcmp(copy, "fmapiron", 8) == 0 && count < size / 8 && size - 8 * (size_t)count >= 2 * FIELDMAP_NAMES)
        repair(copy + FIELDMAP_NAMES + 8 * count, size - FIELDMAP_NAMES - 8 * (size_t)count);
    repair(copy, size);
    if (fieldmap_view(&map, copy, size) == FIELDMAP_OK) ask_map(&map);
    if (fieldmap_iron_view(&iron, copy, size) == FIELDMAP_OK) {
        ask_map(&iron.fields);
        ask_iron(&iron);
    }
    free(copy);
}

/* From a file, as they are. */
static void open_file(const char *path)
{
    fieldmap map;
    fieldmap_iron iron;
    if (fieldmap_open(&map, path) == FIELDMAP_OK) ask_map(&map);
    fieldmap_close(&map);
    if (fieldmap_iron_open(&iron, path) == FIELDMAP_OK) ask_iron(&iron);
    fieldmap_iron_close(&iron);
}

static void report(void)
{
    fprintf(stderr, "accepted: %ld solved: %ld\n", accepted, solved);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    (void)argc;
    (void)argv;
    return atexit(report);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    char path[64];
    FILE *file;
    /* In the folder that it runs in, which is made for it. */
    sprintf(path, "open_map.%ld", (long)getpid());
    file = fopen(path, "wb");
    if (file == NULL || fwrite(bytes, 1, size, file) != size || fclose(file) != 0) _exit(76);
    open_file(path);
    remove(path);
    view(bytes, size);
    return 0;
}

#ifndef OPEN_MAP_MAIN
size_t LLVMFuzzerMutate(uint8_t *bytes, size_t size, size_t most);
size_t LLVMFuzzerCustomMutator(uint8_t *bytes, size_t size, size_t most, unsigned int seed);

/* What libFuzzer makes of bytes, or one of the file's numbers changed, every other time one of the head: sizes and
 * positions are stored as reals, of which a change of bytes hardly ever makes a whole number. */
size_t LLVMFuzzerCustomMutator(uint8_t *bytes, size_t size, size_t most, unsigned int seed)
{
    static const double numbers[] = {-1.0, 0.5, 255.0, 256.0, 257.0, 441.0, 4096.0, 4112.0, 1e5, 1e6, 1e9, 1e300};
    const size_t count = size / 8, known = sizeof numbers / sizeof numbers[0], head = 50;
    const unsigned int way = seed % 4, value = seed / 4 % 64, place = seed / 256;
    double number = (double)value;
    size_t at;
    if (way < 2 || count == 0) return LLVMFuzzerMutate(bytes, size, most);
    at = place % (way == 2 && count > head ? head : count);
    if (value >= 50) number = value - 50 < known ? numbers[value - 50] : value == 62 ? (double)NAN : (double)INFINITY;
    memcpy(bytes + 8 * at, &number, 8);
    return size;
}
#else
int main(int argc, char **argv)
{
    int k;
    for (k = 1; k < argc; k++) {
        void *bytes;
        size_t size = 0;
        if (fieldmap_read_file(argv[k], &bytes, &size) != FIELDMAP_OK) return 1;
        LLVMFuzzerTestOneInput((const uint8_t *)bytes, size);
        free(bytes);
    }
    report();
    return 0;
}
#endif
