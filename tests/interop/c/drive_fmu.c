/* Calls the source of an FMU with sound and unsound arguments, under checkers of memory: argument 1 is the folder of its
 * resources. */
#include "fmu.c"

#include <stdio.h>

static int check(int good, const char *what)
{
    if (!good) fprintf(stderr, "%s\n", what);
    return !good;
}

static void silent(const model *m, int status, const char *text)
{
    UNUSED(m), UNUSED(status), UNUSED(text);
}

int main(int argc, char **argv)
{
    char uri[4096];
    const unsigned everything[4] = {VALUES, VALUES + 1000u, 0xffffffffu, FIELD};
    const unsigned place[3] = {POSITION, POSITION + 1, POSITION + 2};
    double out[64], far[3] = {1.0, 1.0, 1.0}, none = (double)NAN;
    void *kept = NULL;
    size_t i, k = 0;
    int bad = 0;
    model *m;
    if (argc < 2) return 2;
    bad += check(make("a", "another token", argv[1], NULL, NULL, silent) == NULL, "token");
    bad += check(make("a", FMU_TOKEN, "nowhere", NULL, NULL, silent) == NULL, "folder");
    bad += check(make(NULL, FMU_TOKEN, NULL, NULL, NULL, silent) == NULL, "no folder");
    bad += check(make("a", NULL, argv[1], NULL, NULL, silent) == NULL, "no token");
    /* Every character as %XX behind file://. */
    k = (size_t)sprintf(uri, "file://");
    for (i = 0; argv[1][i] != 0 && k < sizeof uri - 4; i++) {
        if (argv[1][i] == '/')
            uri[k++] = '/';
        else
            k += (size_t)sprintf(uri + k, "%%%02X", (unsigned)(unsigned char)argv[1][i]);
    }
    uri[k] = 0;
    m = make("a name that is much longer than what a model keeps of it, which is cut off there", FMU_TOKEN, uri, NULL, NULL, silent);
    bad += check(m != NULL, "URI");
    if (m == NULL) return 1;
    for (i = 0; i < 3; i++) bad += check(get(m, everything + i, 1, out) == ERROR, "reference too large");
    for (i = 0; i < 4; i++) bad += check(set(m, everything + i, 1, out) == ERROR, "not to be set");
    bad += check(get(m, everything + 3, 1, out) == OK && isfinite(out[0]), "field");
    bad += check(keep(m, &kept) == OK, "keep");
    bad += check(set(m, place, 3, far) == OK && get(m, everything + 3, 1, out) == DISCARD && isnan(out[0]), "outside");
    bad += check(advance(m, 1e-3) == (FMU_BODY || FMU_DRIVEN ? DISCARD : OK), "step outside");
    bad += check(restore(m, kept) == OK && get(m, everything + 3, 1, out) == OK, "restore");
    bad += check(advance(m, none) == ERROR && advance(m, -1.0) == ERROR, "length of step");
    bad += check(advance(m, 1e-3) == OK, "step");
    bad += check(get_states(m, out, 64) == ERROR && set_states(m, out, 64) == ERROR, "number of states");
    bad += check(get_states(m, out, STATES) == OK && set_states(m, out, STATES) == OK, "states");
    bad += check(get_derivatives(m, out, STATES) == OK && get_nominals(out, STATES) == OK, "derivatives");
    bad += check(set(m, place, 1, &none) == OK && get(m, everything + 3, 1, out) == DISCARD, "not a number");
    reset(m);
    bad += check(get(m, everything + 3, 1, out) == OK, "reset");
    forget(&kept);
    destroy(m);
    destroy(NULL);
    return bad != 0;
}
