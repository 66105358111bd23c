/* fuzz MAP TRIALS: break a map in many ways, most of them with a checksum that fits again, and ask what still opens.
 * Whatever happens, no byte outside the map may be read: run under sanitizers or valgrind. */
#include "fieldmap.h"

static uint64_t state = 88172645463325252u;

static uint64_t dice(uint64_t sides)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state % sides;
}

static void damage(unsigned char *bytes, size_t size)
{
    static const double odd[] = {0.0, -1.0, 1.5, 1e9, 1e300, 3.0, 20.0, 21.0};
    size_t first = 40, at;
    uint32_t crc;
    int n;
    for (n = 1 + (int)dice(3); n > 0; n--) {
        at = dice(4) == 0 ? dice(size) : dice(first + 8 + 24 * 8);
        if (dice(3) == 0) {
            double value = odd[dice(8)];
            at = at / 8 * 8;
            if (at + 8 <= size) memcpy(bytes + at, &value, 8);
        } else {
            bytes[at] = (unsigned char)dice(256);
        }
    }
    crc = fieldmap_checksum(bytes + 28, size - 28);
    if (dice(8) != 0) memcpy(bytes + 24, &crc, 4);
}

int main(int argc, char **argv)
{
    static const double places[] = {-1e308, -1.0, -0.011, -1e-9, 0.0, 1e-3, 0.0099999999999, 0.02, 1e300, 1e308};
    double currents[8] = {1, 1, 1, 1, 1, 1, 1, 1}, out[64], moment[3] = {0, 0, 1}, point[3];
    unsigned char *whole, *part;
    long trials, size, trial, opened = 0;
    FILE *file;
    int i;
    if (argc != 3 || (file = fopen(argv[1], "rb")) == NULL) return 100;
    trials = atol(argv[2]);
    fseek(file, 0, SEEK_END);
    size = ftell(file);
    rewind(file);
    whole = (unsigned char *)malloc((size_t)size);
    if (whole == NULL || fread(whole, 1, (size_t)size, file) != (size_t)size) return 101;
    fclose(file);
    for (trial = 0; trial < trials; trial++) {
        size_t kept = dice(10) == 0 ? (size_t)dice((uint64_t)size) : (size_t)size;
        fieldmap map, fixed;
        part = (unsigned char *)malloc(kept > 0 ? kept : 1);
        if (part == NULL) return 102;
        memcpy(part, whole, kept);
        if (kept > 300) damage(part, kept);
        if (fieldmap_view(&map, part, kept) == FIELDMAP_OK && map.n_coils <= 8) {
            opened++;
            for (i = 0; i < 50; i++) {
                point[0] = places[dice(10)], point[1] = places[dice(10)], point[2] = places[dice(10)];
                if (dice(2)) point[2] = map.lower[2] + (map.upper[2] - map.lower[2]) * (double)dice(1001) / 1000.0;
                if (dice(2)) point[1] = map.upper[1], point[0] = map.lower[0];
                fieldmap_wrench(&map, currents, point, moment, out);
                fieldmap_second_gradient(&map, currents, point, out);
            }
            fieldmap_coil_name(&map, map.n_coils - 1);
            if (fieldmap_at(&map, currents, &fixed) == FIELDMAP_OK) fieldmap_close(&fixed);
        }
        free(part);
    }
    free(whole);
    printf("%ld of %ld opened\n", opened, trials);
    return 0;
}
