/* ask MAP QUESTIONS ANSWERS: per question currents, point and moment; per answer B, G, second gradient, wrench, and
 * the status. "-" for MAP: print what opening the path in QUESTIONS gives. */
#include "fieldmap.h"

static void answer(const fieldmap *map, const double *currents, const double *rest, double *out)
{
    out[45] = fieldmap_field(map, currents, rest, out, out + 3);
    if (fieldmap_second_gradient(map, currents, rest, out + 12) != (int)out[45]) out[45] = -1;
    if (fieldmap_wrench(map, currents, rest, rest + 3, out + 39) != (int)out[45]) out[45] = -1;
}

int main(int argc, char **argv)
{
    fieldmap map, fixed;
    FILE *questions, *answers;
    double row[64], out[46], again[46];
    size_t length;
    int status, k;
    if (argc != 4) return 100;
    if (strcmp(argv[1], "-") == 0) {
        status = fieldmap_open(&map, argv[2]);
        printf("%d %s\n", status, fieldmap_message(status));
        fieldmap_close(&map);
        return 0;
    }
    status = fieldmap_open(&map, argv[1]);
    if (status != FIELDMAP_OK) return status;
    for (k = 0; k < map.n_coils; k++) printf("%s\n", fieldmap_coil_name(&map, k));
    printf("%.17g %.17g %.17g %.17g\n", map.lower[0], map.lower[2], map.upper[0], map.upper[2]);
    length = (size_t)map.n_coils + 6;
    questions = fopen(argv[2], "rb");
    answers = fopen(argv[3], "wb");
    if (questions == NULL || answers == NULL || length > 64) return 101;
    for (k = 0; fread(row, sizeof(double), length, questions) == length; k++) {
        answer(&map, row, row + map.n_coils, out);
        if (k % 1000 == 0 && fieldmap_at(&map, row, &fixed) == FIELDMAP_OK) {
            /* The same through the map at fixed currents; differences of rounding are the caller's to judge. */
            answer(&fixed, NULL, row + map.n_coils, again);
            memcpy(out, again, sizeof out);
            fieldmap_close(&fixed);
        }
        fwrite(out, sizeof(double), 46, answers);
    }
    fclose(questions);
    fclose(answers);
    fieldmap_close(&map);
    return 0;
}
