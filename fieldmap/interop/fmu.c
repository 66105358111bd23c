/* A map, optionally with a rigid body and its magnet, as an FMU: FMI 2.0 or 3.0, model exchange and co-simulation.
 *
 * Coils with drives use the simulator (machine.h), in co-simulation only: currents are states, and inputs are the demands of
 * the drives. Without a body the magnet moves with constant velocities in a step.
 *
 * Saturating iron is solved at the currents. The memory of iron with hysteresis changes only at steps: each step goes straight
 * to the currents that are set. In model exchange a step is one that the importer has completed.
 *
 * fmu_model.h, which fieldmap.interop.fmu writes, selects the variant; FMU_VERSION is 2 or 3. The declarations are our own,
 * after the standards (fmi-standard.org); this file contains nothing of their headers. Value references are indices of
 * `values`. docs/other_programs.md explains the variables. BSD-3-Clause, the fieldmap developers.
 */
#include <stdbool.h>

#include "fieldmap_body.h"
#include "fmu_model.h"
#if FMU_IRON
#include "fieldmap_iron.h"
#endif
#if FMU_DRIVEN
#include "caller.h"
#include "machine.h"
#endif

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum {
    TIME = 0, POSITION = 1, VELOCITY = 4, TURN = 7, ANGULAR = 11, DERIVATIVES = 14, PUSH = 27, TWIST = 30, STRENGTH = 33,
    MASS = 34, INERTIA = 35, GRAVITY = 38, STEP = 39, FIELD = 40, GRADIENT = 43, FORCE = 52, TORQUE = 55, CURRENTS = 58,
    ASKED = CURRENTS + FMU_COILS, LINKAGES = ASKED + FMU_DRIVEN * FMU_COILS, EMF = LINKAGES + FMU_DRIVEN * FMU_COILS,
    VALUES = EMF + FMU_DRIVEN * FMU_COILS, STATES = FMU_BODY && !FMU_DRIVEN ? 13 : 0
};
#define MOST_STEPS 1e7
enum { OK, WARNING, DISCARD, ERROR, FATAL };

typedef struct model {
#if FMU_IRON
    fieldmap_iron map;
    fieldmap_iron_state state;
    void *memory;       /* memory of `state` */
    double *remembered; /* memory of the iron after the last step; the importer may set other currents between steps */
    int solved;         /* whether the solution of the state starts from `remembered` */
#else
    fieldmap map;
#endif
#if FMU_DRIVEN
    fieldmap_machine machine;
    fieldmap_electrical coils;
    fieldmap_dipole magnet[FMU_DIPOLES];
#endif
    double *run, *room; /* run: numbers of the coils, weights of the fields; room: for induced voltages */
    size_t run_size;
    int running; /* whether the coils continue from their last step, not from the set currents and pose */
    double values[VALUES + 1];
    int stale; /* whether outputs and derivatives are out of date */
    int status;
    void *environment;
    void (*say)(const struct model *, int status, const char *text);
    void (*logger)(void);
    char name[64];
} model;

static const double dipoles[FMU_DIPOLES][6] = FMU_MAGNET; /* position from the body's centre, moment; frame of the body */
static const double seat[3] = FMU_SEAT;                   /* the magnet's centre */
static const double starts[VALUES] = FMU_STARTS;

#if FMU_IRON

static const char *message(int status) { return fieldmap_iron_message(status); }
static const fieldmap *fields(const model *m) { return &m->map.fields; }
static int coils(const model *m) { return m->map.n_coils; }
static void *aligned(const model *m) { return (void *)(((uintptr_t)m->memory + 63) / 64 * 64); }

#if FMU_DRIVEN
/* Steps of the coils start from the complete solver state, not only from the memory of the iron. */
enum { SCALARS = 4 };
static size_t remembered(const model *m) { return SCALARS + fieldmap_iron_memory(&m->map) / sizeof(double); }
static void keep_iron(model *m)
{
    const fieldmap_iron_state *s = &m->state;
    m->remembered[0] = s->count, m->remembered[1] = s->steps, m->remembered[2] = s->left_over, m->remembered[3] = s->heat;
    memcpy(m->remembered + SCALARS, aligned(m), fieldmap_iron_memory(&m->map));
}
static void recall_iron(model *m)
{
    fieldmap_iron_state *s = &m->state;
    s->count = (int)m->remembered[0], s->steps = (int)m->remembered[1];
    s->left_over = m->remembered[2], s->heat = m->remembered[3];
    memcpy(aligned(m), m->remembered + SCALARS, fieldmap_iron_memory(&m->map));
}
#else
static void keep_iron(model *m) { fieldmap_iron_copy(&m->state, m->remembered, NULL); }
static void recall_iron(model *m) { fieldmap_iron_copy(&m->state, NULL, m->remembered); }

/* Numbers that the iron remembers. */
static size_t remembered(const model *m)
{
    fieldmap_iron_state state = m->state;
    return fieldmap_iron_copy(&state, NULL, NULL);
}

static const double *weights(const model *m) { return m->state.solution; }

/* Solve the iron on a straight path from the last step to the currents. step: whether the iron remembers the path. */
static int follow(model *m, int step)
{
    const double *currents = m->values + CURRENTS;
    int k, status, same = m->solved;
    for (k = 0; k < FMU_COILS; k++) same = same && m->state.solution[k] == currents[k];
    if (same && !step) return FIELDMAP_OK;
    m->solved = 0;
    recall_iron(m);
    status = step ? fieldmap_iron_step(&m->state, currents) : fieldmap_iron_follow(&m->state, currents);
    if (status != FIELDMAP_OK) return status;
    if (step) keep_iron(m);
    m->solved = 1;
    return status;
}
#endif

/* Set the initial memory of the file. */
static void begin(model *m)
{
    const size_t size = fieldmap_iron_memory(&m->map);
    fieldmap_iron_start(&m->state, &m->map, aligned(m), size);
    keep_iron(m);
    m->solved = 0;
}

static void close_map(model *m)
{
    free(m->memory);
    free(m->remembered);
    fieldmap_iron_close(&m->map);
}

static int open_file(model *m, const char *path)
{
    const int status = fieldmap_iron_open(&m->map, path);
    if (status != FIELDMAP_OK) return status;
    m->state.map = &m->map;
    m->memory = malloc(fieldmap_iron_memory(&m->map) + 64);
    m->remembered = (double *)malloc(remembered(m) * sizeof(double));
    if (m->memory != NULL && m->remembered != NULL) return FIELDMAP_OK;
    close_map(m);
    return FIELDMAP_NO_MEMORY;
}

static void store(const model *m, double *out) { memcpy(out, m->remembered, remembered(m) * sizeof(double)); }
static void recall(model *m, const double *in)
{
    memcpy(m->remembered, in, remembered(m) * sizeof(double));
    m->solved = 0;
}

#else

static const char *message(int status) { return fieldmap_message(status); }
static const fieldmap *fields(const model *m) { return &m->map; }
static int coils(const model *m) { return m->map.n_coils; }
#if !FMU_DRIVEN
static const double *weights(const model *m) { return FMU_COILS ? m->values + CURRENTS : NULL; }
static int follow(model *m, int step) { (void)m, (void)step; return FIELDMAP_OK; }
#else
static void keep_iron(model *m) { (void)m; }
static void recall_iron(model *m) { (void)m; }
#endif
static size_t remembered(const model *m) { (void)m; return 0; }
static void begin(model *m) { (void)m; }
static void close_map(model *m) { fieldmap_close(&m->map); }
static int open_file(model *m, const char *path) { return fieldmap_open(&m->map, path); }
static void store(const model *m, double *out) { (void)m, (void)out; }
static void recall(model *m, const double *in) { (void)m, (void)in; }

#endif

#if FMU_DRIVEN
static const double *weights(const model *m) { return m->machine.weights; }
#endif

/* Fill the body of a model in the field of its currents; `magnet` gets the dipoles times the strength. */
static void body_of(const model *m, fieldmap_dipole *magnet, fieldmap_rigid_body *body, fieldmap_path *field)
{
    const double *v = m->values;
    int k, i;
    memset(body, 0, sizeof *body);
    memset(field, 0, sizeof *field);
    for (k = 0; k < FMU_DIPOLES; k++)
        for (i = 0; i < 3; i++)
            magnet[k].point[i] = dipoles[k][i], magnet[k].moment[i] = v[STRENGTH] * dipoles[k][3 + i];
    body->magnetic.n_dipoles = FMU_DIPOLES, body->magnetic.dipoles = magnet;
    body->mass = v[MASS], body->gravity[2] = -v[GRAVITY];
    for (i = 0; i < 3; i++) {
        body->inertia[i] = v[INERTIA + i];
        body->force[i] = v[PUSH + i], body->torque[i] = v[TWIST + i];
    }
    field->map = fields(m), field->weights = weights(m);
}

/* Fill the state with a unit quaternion. Returns the length of the quaternion before. */
static double state_of(const model *m, fieldmap_state *state)
{
    double length = 0.0;
    int k;
    memcpy(state, m->values + POSITION, sizeof *state);
    for (k = 0; k < 4; k++) length += state->turn[k] * state->turn[k];
    length = sqrt(length);
    for (k = 0; k < 4; k++) state->turn[k] /= length;
    return length;
}

#if FMU_DRIVEN

static const fieldmap_coil drives[FMU_COILS] = FMU_DRIVES;

/* The machine at the set values. */
static fieldmap_machine *machine_of(model *m)
{
    fieldmap_machine *machine = &m->machine;
    int i;
    body_of(m, m->magnet, &machine->body, &machine->field);
    if (!FMU_BODY) {
        /* Forces do not change the motion of a body with this mass. */
        machine->body.mass = 1e30, machine->body.gravity[2] = 0.0;
        for (i = 0; i < 3; i++) machine->body.inertia[i] = 1e30;
    }
    return machine;
}

static fieldmap_caller caller_of(model *m)
{
    fieldmap_caller of;
    memset(&of, 0, sizeof of);
    of.map = fields(m), of.iron = m->machine.superposition.iron, of.body = &m->machine.body.magnetic;
    return of;
}

/* Set up coils and memory of the machine, which do not depend on the set values. */
static int give_drives(model *m)
{
    fieldmap_electrical *coils = &m->coils;
    fieldmap_superposition *of = &m->machine.superposition;
    fieldmap_caller asked;
    size_t size;
    if (fields(m)->linkage.coils != FMU_COILS) return FIELDMAP_UNLINKED;
    of->scale = 1.0, of->n_coils = of->n_fields = FMU_COILS, of->on_path = 1;
#if FMU_IRON
    of->iron = &m->state, of->n_fields = m->map.n_fields;
#endif
    coils->n = FMU_COILS, coils->fields = of->n_fields, coils->largest = FMU_LARGEST, coils->coils = drives;
    coils->linear = fields(m)->linkage;
    m->machine.n_coils = FMU_COILS, m->machine.electrical = coils;
    machine_of(m);
    asked = caller_of(m);
    size = fieldmap_electrical_room(FMU_COILS, fields(m), FMU_DIPOLES);
    m->run_size = size + (size_t)of->n_fields;
    m->run = (double *)calloc(m->run_size, sizeof(double));
    m->room = (double *)calloc(6 + 6 * FMU_COILS + fieldmap_caller_room(&asked), sizeof(double));
    if (m->run == NULL || m->room == NULL) return FIELDMAP_NO_MEMORY;
    m->machine.weights = m->run + size;
    return FIELDMAP_OK;
}

/* The status, or FIELDMAP_IRON_BEYOND if the iron refuses currents outside its domain. */
static int within_domain(const model *m, int status, int within)
{
#if FMU_IRON
    if (status == FIELDMAP_OK && m->map.checked && !within) return FIELDMAP_IRON_BEYOND;
#endif
    (void)m, (void)within;
    return status;
}

/* Unless the coils are running, start them with the linkages of the set currents and pose. */
static int follow(model *m, int step)
{
    fieldmap_machine *machine = machine_of(m);
    const int64_t outside = machine->superposition.outside, unsolved = machine->superposition.unsolved;
    fieldmap_state state;
    int status;
    (void)step;
    if (m->running) return FIELDMAP_OK;
    recall_iron(m);
#if FMU_IRON
    m->state.checked = 0;
#endif
    memset(m->run, 0, m->run_size * sizeof(double));
    fieldmap_electrical_start(&m->coils, fields(m), FMU_DIPOLES, m->run);
    state_of(m, &state);
    status = fieldmap_coupled_begin(machine, &state, m->values + CURRENTS);
    if (status == FIELDMAP_OK && machine->superposition.unsolved != unsolved) status = FIELDMAP_IRON_NOT_CONVERGED;
    return within_domain(m, status, machine->superposition.outside == outside);
}

/* Fill linkages, and the induced voltages of the motion: d(force)/d(current) along it. The iron's memory does not change. */
static int linkages_and_voltages(model *m, const fieldmap_state *state, const double *r)
{
    double twist[6], *v = m->values, *slopes = m->room + 6;
    const fieldmap_caller of = caller_of(m);
    int i, k, status = fieldmap_caller_wrench(&of, v + CURRENTS, state->position, r, slopes + 6 * FMU_COILS, m->room, slopes);
    for (i = 0; i < 3; i++) twist[i] = state->velocity[i];
    fieldmap_to_map(r, state->angular_velocity, twist + 3);
    for (k = 0; k < FMU_COILS; k++) {
        v[LINKAGES + k] = m->coils.linkage[k], v[EMF + k] = 0.0;
        for (i = 0; i < 6; i++) v[EMF + k] += slopes[i * FMU_COILS + k] * twist[i];
    }
    if (m->running) recall_iron(m);
    return status;
}

/* Run steps of the machine. Returns the status of the map. */
static int run(model *m, double h, long steps)
{
    double *v = m->values, load[6];
    fieldmap_machine *machine;
    fieldmap_state state;
    int64_t unsolved;
    long n;
    int held, touched, within = 1, status = follow(m, 1);
    if (status != FIELDMAP_OK) return status;
    m->running = 1;
    machine = machine_of(m);
    unsolved = machine->superposition.unsolved;
    state_of(m, &state);
    status = fieldmap_load(&machine->field, &machine->body, &state, load, &touched);
    for (n = 0; n < steps && status == FIELDMAP_OK; n++) {
        status = fieldmap_coupled_step(machine, h, v + ASKED, &state, v + CURRENTS, load, &held, &within, &touched);
        if (status == FIELDMAP_OK && machine->superposition.unsolved != unsolved) status = FIELDMAP_IRON_NOT_CONVERGED;
        status = within_domain(m, status, within);
        if (status != FIELDMAP_OK) break;
        if (FMU_BODY) memcpy(v + POSITION, &state, sizeof state);
        v[TIME] += h;
    }
    if (n > 0) fieldmap_warm(&m->coils, (double)n * h);
    keep_iron(m);
    return status;
}

#endif

/* Fill field at the magnet's centre, force and torque about the body's centre, and derivatives of the state. */
static int outputs(model *m)
{
    fieldmap_dipole magnet[FMU_DIPOLES];
    fieldmap_rigid_body body;
    fieldmap_path field;
    fieldmap_state state, rates;
    double *v = m->values, r[9], arm[3], place[3];
    const double length = state_of(m, &state);
    int i, status = follow(m, 0);
    if (status != FIELDMAP_OK) return status;
    body_of(m, magnet, &body, &field);
    fieldmap_rotation(state.turn, r);
    fieldmap_to_map(r, seat, arm);
    for (i = 0; i < 3; i++) place[i] = state.position[i] + arm[i];
    status = fieldmap_field(field.map, field.weights, place, v + FIELD, v + GRADIENT);
    if (status == FIELDMAP_OK)
        status = fieldmap_body_wrench(&field, &body.magnetic, state.position, r, v + FORCE, NULL);
#if FMU_DRIVEN
    if (status == FIELDMAP_OK) status = linkages_and_voltages(m, &state, r);
#endif
    if (status != FIELDMAP_OK || !FMU_BODY) return status;
    status = fieldmap_rates(&field, &body, &state, &rates);
    /* The derivative of a quaternion is proportional to its length. */
    for (i = 0; i < 4; i++) rates.turn[i] *= length;
    memcpy(v + DERIVATIVES, &rates, sizeof rates);
    return status;
}

/* Update outputs and derivatives if the inputs have changed. */
static int refresh(model *m)
{
    double *v = m->values;
    int i, status;
    if (!m->stale) return m->status;
    m->stale = 0;
    status = outputs(m);
    if (status != FIELDMAP_OK) {
        for (i = FIELD; i < CURRENTS; i++) v[i] = (double)NAN;
        for (i = LINKAGES; i < VALUES; i++) v[i] = (double)NAN;
        for (i = 0; i < 13; i++) v[DERIVATIVES + i] = (double)NAN;
        m->say(m, DISCARD, message(status));
    }
    return m->status = status == FIELDMAP_OK ? OK : DISCARD;
}

/* Let the iron remember the currents. */
static int remember(model *m)
{
    const int status = follow(m, 1);
    m->stale = 1;
    if (status == FIELDMAP_OK) return OK;
    m->say(m, DISCARD, message(status));
    return DISCARD;
}

#if !FMU_DRIVEN
/* Run a step of the iron to the inputs, then steps of fourth order of the body at constant inputs. Returns the status of the
 * map. */
static int run(model *m, double h, long steps)
{
    fieldmap_dipole magnet[FMU_DIPOLES];
    fieldmap_rigid_body body;
    fieldmap_path field;
    fieldmap_state state;
    double load[6];
    long n;
    int touched, status = follow(m, 1);
    if (status != FIELDMAP_OK) return status;
    state_of(m, &state);
    body_of(m, magnet, &body, &field);
    status = fieldmap_load(&field, &body, &state, load, &touched);
    for (n = 0; n < steps && status == FIELDMAP_OK; n++) {
        status = fieldmap_step(&field, &body, &state, load, h, 4, &touched);
        if (status != FIELDMAP_OK) break;
        memcpy(m->values + POSITION, &state, sizeof state);
        m->values[TIME] += h;
    }
    return status;
}
#endif

/* Advance by equal steps of at most values[STEP]. */
static int advance(model *m, double duration)
{
    long steps;
    int status;
    if (!(duration >= 0.0)) return ERROR;
    if (!FMU_BODY && !FMU_DRIVEN) return remember(m); /* outputs follow inputs at once */
    if (!(m->values[STEP] > 0.0)) return ERROR;
    if (!(duration / m->values[STEP] <= MOST_STEPS)) return ERROR; /* limit for one call; also refuses NaN and infinity */
    steps = (long)ceil(duration / m->values[STEP] * (1.0 - 1e-9));
    status = run(m, steps > 0 ? duration / (double)steps : 0.0, steps);
    m->stale = 1;
    if (status == FIELDMAP_OK) return OK;
    m->say(m, DISCARD, message(status));
    return DISCARD;
}

static void reset(model *m)
{
    int i;
    memset(m->values, 0, sizeof m->values);
    for (i = 0; i < VALUES; i++) m->values[i] = starts[i];
    begin(m);
    m->running = 0;
    m->stale = 1;
}

static int get(model *m, const unsigned *references, size_t count, double *out)
{
    size_t k;
    int status = OK;
    for (k = 0; k < count; k++) {
        unsigned at = references[k];
        int computed = (at >= FIELD && at < CURRENTS) || at >= LINKAGES || (FMU_BODY && at >= DERIVATIVES && at < PUSH);
        if (at >= VALUES) return ERROR;
        if (computed && refresh(m) > status) status = m->status;
        out[k] = m->values[at];
    }
    return status;
}

static int set(model *m, const unsigned *references, size_t count, const double *values)
{
    size_t k;
    for (k = 0; k < count; k++) {
        unsigned at = references[k];
        int computed = at == TIME || (at >= DERIVATIVES && at < PUSH) || (at >= FIELD && at < CURRENTS) || at >= LINKAGES;
        if (at >= VALUES || computed) return ERROR;
        m->values[at] = values[k];
        if ((at >= CURRENTS && at < ASKED) || (FMU_BODY && at >= POSITION && at < DERIVATIVES)) m->running = 0;
    }
    m->stale = 1;
    return OK;
}

/* Open the map in the folder of resources, given as a path or, in FMI 2, as a URI. */
static int open_map(model *m, const char *folder)
{
    static const char map_name[] = "map.fmap";
    size_t size = folder == NULL ? 0 : strlen(folder), i = 0, n = 0;
    char *path = (char *)malloc(size + sizeof map_name + 2);
    int status;
    if (path == NULL) return FIELDMAP_NO_MEMORY;
    if (size >= 5 && strncmp(folder, "file:", 5) == 0) {
        i = 5;
        if (size >= 7 && folder[5] == '/' && folder[6] == '/') {
            for (i = 7; i < size && folder[i] != '/'; i++) {} /* host */
        }
        if (size > i + 2 && folder[i] == '/' && folder[i + 2] == ':') i++; /* /C:/ */
        for (; i < size; i++) {
            unsigned code;
            char digits[3] = {0, 0, 0};
            if (folder[i] == '%' && i + 2 < size) {
                digits[0] = folder[i + 1], digits[1] = folder[i + 2];
                code = (unsigned)strtoul(digits, NULL, 16);
                path[n++] = (char)code;
                i += 2;
            } else {
                path[n++] = folder[i];
            }
        }
    } else {
        for (; i < size; i++) path[n++] = folder[i];
    }
    if (n > 0 && path[n - 1] != '/' && path[n - 1] != '\\') path[n++] = '/';
    memcpy(path + n, map_name, sizeof map_name);
    status = open_file(m, path);
    if (status == FIELDMAP_OK && coils(m) != (FMU_COILS ? FMU_COILS : 1)) {
        close_map(m);
        status = FIELDMAP_DAMAGED;
    }
#if FMU_DRIVEN
    if (status == FIELDMAP_OK) status = give_drives(m);
#endif
    free(path);
    return status;
}

static model *make(const char *name, const char *token, const char *folder, void *environment,
    void (*logger)(void), void (*say)(const model *, int, const char *))
{
    model *m = (model *)calloc(1, sizeof(model));
    int status;
    if (m == NULL) return NULL;
    m->environment = environment, m->logger = logger, m->say = say;
    if (name != NULL) strncpy(m->name, name, sizeof m->name - 1);
    if (token == NULL || strcmp(token, FMU_TOKEN) != 0) {
        say(m, ERROR, "another model description than the binary's");
        free(m);
        return NULL;
    }
    status = open_map(m, folder);
    if (status != FIELDMAP_OK) {
        say(m, ERROR, message(status));
        free(m);
        return NULL;
    }
    reset(m);
    return m;
}

static void destroy(model *m)
{
    if (m != NULL) {
        close_map(m);
        free(m->run);
        free(m->room);
        free(m);
    }
}

static int get_states(const model *m, double *out, size_t count)
{
    if (count != (size_t)STATES) return ERROR;
    memcpy(out, m->values + POSITION, count * sizeof(double));
    return OK;
}

static int set_states(model *m, const double *states, size_t count)
{
    if (count != (size_t)STATES) return ERROR;
    memcpy(m->values + POSITION, states, count * sizeof(double));
    m->stale = 1;
    return OK;
}

static int get_derivatives(model *m, double *out, size_t count)
{
    int status = count == 0 ? OK : refresh(m);
    if (count != (size_t)STATES) return ERROR;
    memcpy(out, m->values + DERIVATIVES, count * sizeof(double));
    return status;
}

static int get_nominals(double *out, size_t count)
{
    static const double sizes[13] = {0.01, 0.01, 0.01, 0.1, 0.1, 0.1, 1, 1, 1, 1, 10, 10, 10};
    if (count != (size_t)STATES) return ERROR;
    memcpy(out, sizes, count * sizeof(double));
    return OK;
}

/* Copy all values, the memory of the iron and the run of the coils for the importer. */
static int keep(const model *m, void **kept)
{
    double *out;
    size_t i;
    if (*kept == NULL) *kept = malloc(sizeof m->values + (remembered(m) + m->run_size + 1) * sizeof(double));
    if (*kept == NULL) return ERROR;
    memcpy(*kept, m->values, sizeof m->values);
    store(m, (double *)*kept + VALUES + 1);
    out = (double *)*kept + VALUES + 1 + remembered(m);
    for (i = 0; i < m->run_size; i++) out[i] = m->run[i];
    out[m->run_size] = m->running;
    return OK;
}

static int restore(model *m, const void *kept)
{
    const double *in;
    size_t i;
    if (kept == NULL) return ERROR;
    memcpy(m->values, kept, sizeof m->values);
    recall(m, (const double *)kept + VALUES + 1);
    in = (const double *)kept + VALUES + 1 + remembered(m);
    for (i = 0; i < m->run_size; i++) m->run[i] = in[i];
    m->running = in[m->run_size] != 0.0;
#if FMU_DRIVEN
    m->coils.step = 0.0, m->coils.known = m->running;
    if (m->running) recall_iron(m);
#endif
    m->stale = 1;
    return OK;
}

static int forget(void **kept)
{
    free(*kept);
    *kept = NULL;
    return OK;
}

#define UNUSED(x) (void)(x)

#if FMU_VERSION == 2

typedef void (*fmi2_logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    fmi2_logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} fmi2_callbacks;
typedef struct {
    int needed, terminate, nominals_changed, values_changed, next_defined;
    double next;
} fmi2_event_info;

static void say(const model *m, int status, const char *text)
{
    if (m->logger != NULL) ((fmi2_logger)m->logger)(m->environment, m->name, status, "logStatus", "%s", text);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(model *m, int on, size_t n, const char *const categories[])
{
    UNUSED(m), UNUSED(on), UNUSED(n), UNUSED(categories);
    return OK;
}
EXPORT model *fmi2Instantiate(const char *name, int kind, const char *token, const char *folder,
    const fmi2_callbacks *callbacks, int visible, int logging)
{
    UNUSED(kind), UNUSED(visible), UNUSED(logging);
    return make(name, token, folder, callbacks == NULL ? NULL : callbacks->environment,
        callbacks == NULL ? NULL : (void (*)(void))callbacks->logger, say);
}
EXPORT void fmi2FreeInstance(model *m) { destroy(m); }
EXPORT int fmi2SetupExperiment(model *m, int tolerance_given, double tolerance, double start, int stop_given, double stop)
{
    UNUSED(tolerance_given), UNUSED(tolerance), UNUSED(stop_given), UNUSED(stop);
    m->values[TIME] = start;
    return OK;
}
EXPORT int fmi2EnterInitializationMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi2ExitInitializationMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi2Terminate(model *m) { UNUSED(m); return OK; }
EXPORT int fmi2Reset(model *m) { reset(m); return OK; }
EXPORT int fmi2GetReal(model *m, const unsigned r[], size_t n, double out[]) { return get(m, r, n, out); }
EXPORT int fmi2SetReal(model *m, const unsigned r[], size_t n, const double in[]) { return set(m, r, n, in); }
#define NONE_OF(NAME, TYPE) \
    EXPORT int fmi2Get##NAME(model *m, const unsigned r[], size_t n, TYPE out[]) \
    { UNUSED(m), UNUSED(r), UNUSED(out); return n == 0 ? OK : ERROR; } \
    EXPORT int fmi2Set##NAME(model *m, const unsigned r[], size_t n, const TYPE in[]) \
    { UNUSED(m), UNUSED(r), UNUSED(in); return n == 0 ? OK : ERROR; }
NONE_OF(Integer, int)
NONE_OF(Boolean, int)
NONE_OF(String, char *)
EXPORT int fmi2GetFMUstate(model *m, void **kept) { return keep(m, kept); }
EXPORT int fmi2SetFMUstate(model *m, void *kept) { return restore(m, kept); }
EXPORT int fmi2FreeFMUstate(model *m, void **kept) { UNUSED(m); return forget(kept); }
EXPORT int fmi2SerializedFMUstateSize(model *m, void *kept, size_t *size) { UNUSED(m), UNUSED(kept), UNUSED(size); return ERROR; }
EXPORT int fmi2SerializeFMUstate(model *m, void *kept, char out[], size_t size)
{
    UNUSED(m), UNUSED(kept), UNUSED(out), UNUSED(size);
    return ERROR;
}
EXPORT int fmi2DeSerializeFMUstate(model *m, const char in[], size_t size, void **kept)
{
    UNUSED(m), UNUSED(in), UNUSED(size), UNUSED(kept);
    return ERROR;
}
EXPORT int fmi2GetDirectionalDerivative(model *m, const unsigned of[], size_t n, const unsigned by[], size_t k,
    const double seed[], double out[])
{
    UNUSED(m), UNUSED(of), UNUSED(n), UNUSED(by), UNUSED(k), UNUSED(seed), UNUSED(out);
    return ERROR;
}
EXPORT int fmi2EnterEventMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi2NewDiscreteStates(model *m, fmi2_event_info *info)
{
    UNUSED(m);
    memset(info, 0, sizeof *info);
    return OK;
}
EXPORT int fmi2EnterContinuousTimeMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi2CompletedIntegratorStep(model *m, int no_return, int *event, int *terminate)
{
    UNUSED(no_return);
    *event = *terminate = 0;
    return remember(m);
}
EXPORT int fmi2SetTime(model *m, double time) { m->values[TIME] = time; return OK; }
EXPORT int fmi2SetContinuousStates(model *m, const double in[], size_t n) { return set_states(m, in, n); }
EXPORT int fmi2GetContinuousStates(model *m, double out[], size_t n) { return get_states(m, out, n); }
EXPORT int fmi2GetDerivatives(model *m, double out[], size_t n) { return get_derivatives(m, out, n); }
EXPORT int fmi2GetEventIndicators(model *m, double out[], size_t n) { UNUSED(m), UNUSED(out); return n == 0 ? OK : ERROR; }
EXPORT int fmi2GetNominalsOfContinuousStates(model *m, double out[], size_t n) { UNUSED(m); return get_nominals(out, n); }
EXPORT int fmi2SetRealInputDerivatives(model *m, const unsigned r[], size_t n, const int order[], const double in[])
{
    UNUSED(m), UNUSED(r), UNUSED(order), UNUSED(in);
    return n == 0 ? OK : ERROR;
}
EXPORT int fmi2GetRealOutputDerivatives(model *m, const unsigned r[], size_t n, const int order[], double out[])
{
    UNUSED(m), UNUSED(r), UNUSED(order), UNUSED(out);
    return n == 0 ? OK : ERROR;
}
EXPORT int fmi2DoStep(model *m, double time, double step, int no_return)
{
    int status;
    UNUSED(no_return);
    m->values[TIME] = time;
    status = advance(m, step);
    if (status == OK) m->values[TIME] = time + step;
    return status;
}
EXPORT int fmi2CancelStep(model *m) { UNUSED(m); return ERROR; }
EXPORT int fmi2GetStatus(model *m, int kind, int *out) { UNUSED(m), UNUSED(kind), UNUSED(out); return DISCARD; }
EXPORT int fmi2GetRealStatus(model *m, int kind, double *out)
{
    if (kind != 2) return DISCARD; /* the last successful time */
    *out = m->values[TIME];
    return OK;
}
EXPORT int fmi2GetIntegerStatus(model *m, int kind, int *out) { UNUSED(m), UNUSED(kind), UNUSED(out); return DISCARD; }
EXPORT int fmi2GetBooleanStatus(model *m, int kind, int *out)
{
    UNUSED(m), UNUSED(kind);
    *out = 0; /* not terminated */
    return OK;
}
EXPORT int fmi2GetStringStatus(model *m, int kind, const char **out) { UNUSED(m), UNUSED(kind), UNUSED(out); return DISCARD; }

#else

typedef void (*fmi3_logger)(void *, int, const char *, const char *);

static void say(const model *m, int status, const char *text)
{
    if (m->logger != NULL) ((fmi3_logger)m->logger)(m->environment, status, "logStatus", text);
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT int fmi3SetDebugLogging(model *m, bool on, size_t n, const char *const categories[])
{
    UNUSED(m), UNUSED(on), UNUSED(n), UNUSED(categories);
    return OK;
}
EXPORT model *fmi3InstantiateModelExchange(const char *name, const char *token, const char *folder, bool visible,
    bool logging, void *environment, fmi3_logger logger)
{
    UNUSED(visible), UNUSED(logging);
    return make(name, token, folder, environment, (void (*)(void))logger, say);
}
EXPORT model *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *folder, bool visible,
    bool logging, bool events, bool early, const unsigned required[], size_t n, void *environment, fmi3_logger logger,
    void (*intermediate)(void))
{
    UNUSED(visible), UNUSED(logging), UNUSED(events), UNUSED(early), UNUSED(required), UNUSED(n), UNUSED(intermediate);
    return make(name, token, folder, environment, (void (*)(void))logger, say);
}
EXPORT model *fmi3InstantiateScheduledExecution(void) { return NULL; }
EXPORT void fmi3FreeInstance(model *m) { destroy(m); }
EXPORT int fmi3EnterInitializationMode(model *m, bool tolerance_given, double tolerance, double start, bool stop_given,
    double stop)
{
    UNUSED(tolerance_given), UNUSED(tolerance), UNUSED(stop_given), UNUSED(stop);
    m->values[TIME] = start;
    return OK;
}
EXPORT int fmi3ExitInitializationMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi3EnterEventMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi3Terminate(model *m) { UNUSED(m); return OK; }
EXPORT int fmi3Reset(model *m) { reset(m); return OK; }
EXPORT int fmi3GetFloat64(model *m, const unsigned r[], size_t n, double out[], size_t k)
{
    return n == k ? get(m, r, n, out) : ERROR;
}
EXPORT int fmi3SetFloat64(model *m, const unsigned r[], size_t n, const double in[], size_t k)
{
    return n == k ? set(m, r, n, in) : ERROR;
}
#define NONE_OF(NAME, TYPE) \
    EXPORT int fmi3Get##NAME(model *m, const unsigned r[], size_t n, TYPE out[], size_t k) \
    { UNUSED(m), UNUSED(r), UNUSED(out), UNUSED(k); return n == 0 ? OK : ERROR; } \
    EXPORT int fmi3Set##NAME(model *m, const unsigned r[], size_t n, const TYPE in[], size_t k) \
    { UNUSED(m), UNUSED(r), UNUSED(in), UNUSED(k); return n == 0 ? OK : ERROR; }
NONE_OF(Float32, float)
NONE_OF(Int8, int8_t)
NONE_OF(UInt8, uint8_t)
NONE_OF(Int16, int16_t)
NONE_OF(UInt16, uint16_t)
NONE_OF(Int32, int32_t)
NONE_OF(UInt32, uint32_t)
NONE_OF(Int64, int64_t)
NONE_OF(UInt64, uint64_t)
NONE_OF(Boolean, bool)
NONE_OF(String, char *)
/* Functions for features that the model does not have: they ignore their arguments and return an error. */
#define NOT_HERE(NAME) EXPORT int fmi3##NAME(void) { return ERROR; }
NOT_HERE(GetBinary)
NOT_HERE(SetBinary)
NOT_HERE(GetClock)
NOT_HERE(SetClock)
NOT_HERE(GetNumberOfVariableDependencies)
NOT_HERE(GetVariableDependencies)
NOT_HERE(SerializedFMUStateSize)
NOT_HERE(SerializeFMUState)
NOT_HERE(DeserializeFMUState)
NOT_HERE(GetDirectionalDerivative)
NOT_HERE(GetAdjointDerivative)
NOT_HERE(GetIntervalDecimal)
NOT_HERE(GetIntervalFraction)
NOT_HERE(GetShiftDecimal)
NOT_HERE(GetShiftFraction)
NOT_HERE(SetIntervalDecimal)
NOT_HERE(SetIntervalFraction)
NOT_HERE(SetShiftDecimal)
NOT_HERE(SetShiftFraction)
NOT_HERE(ActivateModelPartition)
NOT_HERE(GetOutputDerivatives)
NOT_HERE(EnterConfigurationMode)
NOT_HERE(ExitConfigurationMode)
EXPORT int fmi3GetFMUState(model *m, void **kept) { return keep(m, kept); }
EXPORT int fmi3SetFMUState(model *m, void *kept) { return restore(m, kept); }
EXPORT int fmi3FreeFMUState(model *m, void **kept) { UNUSED(m); return forget(kept); }
EXPORT int fmi3EvaluateDiscreteStates(model *m) { UNUSED(m); return OK; }
EXPORT int fmi3UpdateDiscreteStates(model *m, bool *needed, bool *terminate, bool *nominals_changed,
    bool *values_changed, bool *next_defined, double *next)
{
    UNUSED(m), UNUSED(next);
    *needed = *terminate = *nominals_changed = *values_changed = *next_defined = false;
    return OK;
}
EXPORT int fmi3EnterContinuousTimeMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi3CompletedIntegratorStep(model *m, bool no_return, bool *event, bool *terminate)
{
    UNUSED(no_return);
    *event = *terminate = false;
    return remember(m);
}
EXPORT int fmi3SetTime(model *m, double time) { m->values[TIME] = time; return OK; }
EXPORT int fmi3SetContinuousStates(model *m, const double in[], size_t n) { return set_states(m, in, n); }
EXPORT int fmi3GetContinuousStates(model *m, double out[], size_t n) { return get_states(m, out, n); }
EXPORT int fmi3GetContinuousStateDerivatives(model *m, double out[], size_t n) { return get_derivatives(m, out, n); }
EXPORT int fmi3GetEventIndicators(model *m, double out[], size_t n) { UNUSED(m), UNUSED(out); return n == 0 ? OK : ERROR; }
EXPORT int fmi3GetNominalsOfContinuousStates(model *m, double out[], size_t n) { UNUSED(m); return get_nominals(out, n); }
EXPORT int fmi3GetNumberOfEventIndicators(model *m, size_t *n) { UNUSED(m); *n = 0; return OK; }
EXPORT int fmi3GetNumberOfContinuousStates(model *m, size_t *n) { UNUSED(m); *n = STATES; return OK; }
EXPORT int fmi3EnterStepMode(model *m) { UNUSED(m); return OK; }
EXPORT int fmi3DoStep(model *m, double time, double step, bool no_return, bool *event, bool *terminate, bool *early,
    double *reached)
{
    int status;
    UNUSED(no_return);
    m->values[TIME] = time;
    status = advance(m, step);
    if (status == OK) m->values[TIME] = time + step;
    *event = *terminate = *early = false;
    *reached = m->values[TIME];
    return status;
}

#endif
