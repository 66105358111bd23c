/* Answers questions about a map of saturating iron; takes no memory once it runs.
 *
 * ask_iron MAP QUESTIONS ANSWERS TOLERANCE: rows of currents, point, moment -> weights, their slopes, B, G, wrench, status.
 * ask_iron MAP: the status of opening it.
 */
#include "fieldmap_iron.h"

static int forbidden;

void *__real_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__real_realloc(void *old, size_t size);
void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_realloc(void *old, size_t size);

void *__wrap_malloc(size_t size)
{
    if (forbidden) abort();
    return __real_malloc(size);
}

void *__wrap_calloc(size_t count, size_t size)
{
    if (forbidden) abort();
    return __real_calloc(count, size);
}

void *__wrap_realloc(void *old, size_t size)
{
    if (forbidden) abort();
    return __real_realloc(old, size);
}

static double memory[1 << 21];
static double row[64], weights[512], slopes[512 * 32], flux[3], gradient[9], wrench[6];

int main(int argc, char **argv)
{
    fieldmap_iron map;
    fieldmap_iron_state state;
    FILE *questions, *answers;
    void *place = (void *)(((uintptr_t)memory + 63) / 64 * 64);
    size_t c, f;
    int status = fieldmap_iron_open(&map, argv[1]);
    if (status == FIELDMAP_OK) status = fieldmap_iron_start(&state, &map, place, sizeof memory - 64);
    if (argc < 5) {
        printf("%d %s\n", status, fieldmap_iron_message(status));
        if (status == FIELDMAP_OK && argc == 2) {
            /* A damaged file that opens must be safe to ask. */
            for (c = 0; c < (size_t)map.n_coils && c < 32; c++) row[c] = 0.7;
            if (map.n_fields <= 512 && map.n_coils <= 32) fieldmap_iron_slopes(&state, row, weights, slopes);
        }
        fieldmap_iron_close(&map);
        return 0;
    }
    if (status != FIELDMAP_OK) return 2;
    c = (size_t)map.n_coils, f = (size_t)map.n_fields;
    state.tolerance = atof(argv[4]);
    questions = fopen(argv[2], "rb");
    answers = fopen(argv[3], "wb");
    if (questions == NULL || answers == NULL || f > 512 || c > 32) return 3;
    while (fread(row, sizeof(double), c + 6, questions) == c + 6) {
        double said;
        forbidden = 1;
        status = fieldmap_iron_slopes(&state, row, weights, slopes);
        fieldmap_iron_field(&state, row, row + c, flux, gradient);
        fieldmap_iron_wrench(&state, row, row + c, row + c + 3, wrench);
        forbidden = 0;
        said = status;
        fwrite(weights, sizeof(double), f, answers);
        fwrite(slopes, sizeof(double), f * c, answers);
        fwrite(flux, sizeof(double), 3, answers);
        fwrite(gradient, sizeof(double), 9, answers);
        fwrite(wrench, sizeof(double), 6, answers);
        fwrite(&said, sizeof(double), 1, answers);
    }
    fclose(questions);
    fclose(answers);
    fieldmap_iron_close(&map);
    return 0;
}
