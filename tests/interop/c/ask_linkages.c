/* ask_linkages MAP QUESTIONS ANSWERS: per question currents, point and moment; per answer the linkages with the dipole and
 * without, inductances, and the status. With -DIRON of saturating iron; iron that remembers steps to the currents and is asked
 * at 0.9 of them, off the ends of the play of its cells. With
 * -DMAP="lift.h" -DNAME=lift of a map in single precision, compiled in. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(MAP)
#include MAP
typedef float real;
#elif defined(IRON)
#include "fieldmap_iron.h"
typedef double real;
#else
#include "fieldmap.h"
typedef double real;
#endif

int main(int argc, char **argv)
{
    FILE *questions, *answers;
    real row[70], with[64], without[64], inductance[64 * 64], status;
    size_t n;
#if defined(MAP)
    const real none[3] = {0.0f, 0.0f, 0.0f};
    n = (size_t)NAME.coils;
#elif defined(IRON)
    fieldmap_iron map;
    fieldmap_iron_state state;
    void *memory;
    double *room;
    size_t k;
    if (argc != 4 || fieldmap_iron_open(&map, argv[1]) != FIELDMAP_OK) return 2;
    memory = malloc(fieldmap_iron_memory(&map) + 64);
    room = (double *)malloc(fieldmap_iron_linkage_room(&map) * sizeof(double));
    if (fieldmap_iron_start(&state, &map, (void *)(((uintptr_t)memory + 63) / 64 * 64), fieldmap_iron_memory(&map)) != FIELDMAP_OK)
        return 3;
    if (map.n_cells == 0) state.tolerance = 1e-13;
    n = (size_t)map.n_coils;
#else
    fieldmap map;
    if (argc != 4 || fieldmap_open(&map, argv[1]) != FIELDMAP_OK) return 2;
    n = (size_t)map.n_coils;
#endif
    questions = fopen(argv[argc - 2], "rb");
    answers = fopen(argv[argc - 1], "wb");
    if (n > 64 || questions == NULL || answers == NULL) return 4;
    while (fread(row, sizeof(real), n + 6, questions) == n + 6) {
#if defined(MAP)
        status = (real)fm32_flux_linkage(&NAME, row, row + n, row + n + 3, with);
        fm32_flux_linkage(&NAME, row, row + n, none, without);
        if (NAME.linkage.coils > 0) memcpy(inductance, NAME.linkage.inductance, n * n * sizeof(real));
#elif defined(IRON)
        fieldmap_iron_step(&state, row);
        for (k = 0; map.n_cells > 0 && k < n; k++) row[k] *= 0.9;
        status = fieldmap_iron_flux_linkage(&state, row, row + n, row + n + 3, room, with, inductance);
        fieldmap_iron_flux_linkage(&state, row, NULL, NULL, room, without, NULL);
#else
        status = fieldmap_flux_linkage(&map, row, row + n, row + n + 3, with);
        fieldmap_flux_linkage(&map, row, NULL, NULL, without);
        if (map.linkage.coils > 0) memcpy(inductance, map.linkage.inductance, n * n * sizeof(real));
#endif
        fwrite(with, sizeof(real), n, answers);
        fwrite(without, sizeof(real), n, answers);
        fwrite(inductance, sizeof(real), n * n, answers);
        fwrite(&status, sizeof(real), 1, answers);
    }
    fclose(questions);
    fclose(answers);
#if defined(IRON)
    free(memory);
    free(room);
    fieldmap_iron_close(&map);
#elif !defined(MAP)
    fieldmap_close(&map);
#endif
    return 0;
}
