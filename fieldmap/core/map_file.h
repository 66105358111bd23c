/* map_file.h: opens and checks a map in a file or in memory. All numbers are double.
 *
 * fieldmap.interop.c_map writes such files and describes their layout.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MAP_FILE_H
#define FIELDMAP_MAP_FILE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "block.h"
#include "reaction.h"

/* Size of the header before the names, bytes. */
enum { FIELDMAP_NAMES = 40 };

/* Text of a status. */
static inline const char *fieldmap_message(int status)
{
    static const char *const texts[] = {
        "done", "point outside the map's box", "point or current is NaN or infinite",
        "file cannot be opened or read", "file is shorter than it says", "not a map for C (fieldmap export --to c)",
        "written by a newer version", "written for the other byte order", "damaged: sizes or checksum do not fit",
        "no memory", "address is not a multiple of 8", "argument missing", "map without flux linkages of its coils"};
    return status >= 0 && status <= FIELDMAP_UNLINKED ? texts[status] : "unknown status";
}

/* CRC-32 of zlib and PNG, four bits at a time. */
static inline uint32_t fieldmap_checksum(const unsigned char *bytes, size_t size)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};
    uint32_t crc = 0xffffffffu;
    size_t i;
    for (i = 0; i < size; i++) {
        crc = table[(crc ^ bytes[i]) & 15u] ^ (crc >> 4);
        crc = table[(crc ^ ((uint32_t)bytes[i] >> 4)) & 15u] ^ (crc >> 4);
    }
    return crc ^ 0xffffffffu;
}

/* Check that `size` bytes are a complete file of fieldmap that begins with eight letters: at an address that is a multiple of
 * 8, at least `least` bytes, in this byte order, of version 1 to `newest`, and with the right checksum. Fills version. */
static inline int fieldmap_check_file(
    const void *bytes, size_t size, const char *letters, size_t least, uint32_t newest, uint32_t *version)
{
    const unsigned char *raw = (const unsigned char *)bytes;
    uint32_t order, crc;
    uint64_t total;
    if ((uintptr_t)bytes % 8 != 0) return FIELDMAP_ALIGNMENT;
    if (size < 8 || memcmp(raw, letters, 8) != 0) return FIELDMAP_NOT_A_MAP;
    if (size < least) return FIELDMAP_TRUNCATED;
    memcpy(&order, raw + 8, 4);
    memcpy(version, raw + 12, 4);
    memcpy(&total, raw + 16, 8);
    memcpy(&crc, raw + 24, 4);
    if (order != 0x01020304u) return FIELDMAP_BYTE_ORDER;
    if (*version < 1u || *version > newest) return FIELDMAP_VERSION;
    if (total > size) return FIELDMAP_TRUNCATED;
    return total == size && crc == fieldmap_checksum(raw + 28, size - 28) ? FIELDMAP_OK : FIELDMAP_DAMAGED;
}

/* Read a whole file into memory that the caller must free. */
static inline int fieldmap_read_file(const char *path, void **bytes, size_t *size)
{
    FILE *file = fopen(path, "rb");
    long length = -1;
    int status = FIELDMAP_NO_FILE;
    *bytes = NULL;
    if (file == NULL) return FIELDMAP_NO_FILE;
    if (fseek(file, 0, SEEK_END) == 0) length = ftell(file);
    /* A folder can be opened too, and may report any length, but reading from it fails. */
    if (length > 0 && (fseek(file, 0, SEEK_SET) != 0 || fgetc(file) == EOF)) length = -1;
    if (length >= 0 && fseek(file, 0, SEEK_SET) == 0) {
        *size = (size_t)length;
        *bytes = malloc(length > 0 ? *size : 1);
        if (*bytes == NULL)
            status = FIELDMAP_NO_MEMORY;
        else if (fread(*bytes, 1, *size, file) == *size)
            status = FIELDMAP_OK;
    }
    fclose(file);
    return status;
}

/* Use a map in memory, for example in flash, without a copy: `bytes`, at an address that is a multiple of 8, must outlive the
 * map. Nothing is allocated. */
static inline int fieldmap_view(fieldmap *map, const void *bytes, size_t size)
{
    const unsigned char *raw = (const unsigned char *)bytes;
    const double *block;
    uint32_t version, name_bytes;
    uint64_t count, set, linkages;
    long sets, reacting, repelled, linked;
    size_t i, ended = 0;
    int status;
    if (map == NULL || bytes == NULL) return FIELDMAP_ARGUMENT;
    memset(map, 0, sizeof *map);
    status = fieldmap_check_file(bytes, size, "fieldmap", FIELDMAP_NAMES, 4u, &version);
    if (status != FIELDMAP_OK) return status;
    memcpy(&name_bytes, raw + 28, 4);
    memcpy(&count, raw + 32, 8);
    if (name_bytes % 8u != 0 || name_bytes > size - FIELDMAP_NAMES) return FIELDMAP_DAMAGED;
    if (count > (size - FIELDMAP_NAMES - name_bytes) / 8 || count * 8 != size - FIELDMAP_NAMES - name_bytes)
        return FIELDMAP_DAMAGED;
    if (count < FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    block = (const double *)(const void *)(raw + FIELDMAP_NAMES + name_bytes);
    sets = fieldmap_whole(block[FIELDMAP_SETS], 1, 1000000);
    reacting = fieldmap_whole(block[FIELDMAP_REACTING], 0, FIELDMAP_REACTION_FIELDS);
    repelled = fieldmap_whole(block[FIELDMAP_REPELLED], 0, reacting);
    linked = fieldmap_whole(block[FIELDMAP_LINKED], 0, sets);
    /* The checksum covers the sizes but not the version, so the version must agree with the sizes. */
    if (sets < 0 || reacting < 0 || repelled < 0 || linked < 0) return FIELDMAP_DAMAGED;
    if ((linked > 0) != (version == 4u) || (version < 4u && (reacting > 0) != (version == 3u))) return FIELDMAP_DAMAGED;
    linkages = (uint64_t)linked * (uint64_t)(linked + 1);
    if (linkages > count - FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    count -= linkages;
    set = (count - FIELDMAP_HEADER) / (uint64_t)(sets + reacting);
    if (set * (uint64_t)(sets + reacting) != count - FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    status = fieldmap_of_block(map, block, FIELDMAP_HEADER + set * (uint64_t)sets, 3);
    if (status == FIELDMAP_OK && map->kind == FIELDMAP_HERMITE) status = FIELDMAP_DAMAGED;
    if (status == FIELDMAP_OK && fieldmap_whole(block[FIELDMAP_CONSTANT], 0, 1) < 0) status = FIELDMAP_DAMAGED;
    if (status == FIELDMAP_OK && version < 3u && block[FIELDMAP_CONSTANT] != (version == 2u ? 1.0 : 0.0))
        status = FIELDMAP_DAMAGED;
    if (status == FIELDMAP_OK && block[FIELDMAP_CONSTANT] == 1.0) {
        map->constant = 1;
        map->n_coils -= 1;
        if (map->n_coils < 1) status = FIELDMAP_DAMAGED;
    }
    if (status == FIELDMAP_OK && reacting > 0) {
        map->reaction = map->coefficients + set * (uint64_t)sets;
        map->reacting = (int)reacting, map->repelled = (int)repelled;
    }
    map->linkage.coils = (int)linked;
    map->linkage.inductance = block + count, map->linkage.constant = block + count + linked * linked;
    for (i = 0; i < name_bytes; i++) ended += raw[FIELDMAP_NAMES + i] == 0;
    if (status == FIELDMAP_OK && ended < (size_t)map->n_coils) status = FIELDMAP_DAMAGED;
    map->names = (const char *)(raw + FIELDMAP_NAMES);
    if (status != FIELDMAP_OK) memset(map, 0, sizeof *map);
    return status;
}

/* Free the memory of fieldmap_open or fieldmap_at. A map of zeros is allowed. */
static inline void fieldmap_close(fieldmap *map)
{
    if (map != NULL) {
        free(map->owned);
        memset(map, 0, sizeof *map);
    }
}

/* Read a map from a file. */
static inline int fieldmap_open(fieldmap *map, const char *path)
{
    void *bytes;
    size_t size = 0;
    int status;
    if (map == NULL || path == NULL) return FIELDMAP_ARGUMENT;
    memset(map, 0, sizeof *map);
    status = fieldmap_read_file(path, &bytes, &size);
    if (status == FIELDMAP_OK) status = fieldmap_view(map, bytes, size);
    if (status == FIELDMAP_OK)
        map->owned = bytes;
    else
        free(bytes);
    return status;
}

/* Name of coil k, or NULL. */
static inline const char *fieldmap_coil_name(const fieldmap *map, int k)
{
    const char *name;
    if (map == NULL || map->names == NULL || k < 0 || k >= map->n_coils) return NULL;
    for (name = map->names; k > 0; k--) name += strlen(name) + 1;
    return name;
}

/* Fill `fixed`, a copy of the map at fixed currents, which takes currents = NULL and must be closed. `map` may be closed. */
static inline int fieldmap_at(const fieldmap *map, const double *currents, fieldmap *fixed)
{
    size_t size, places, n, sets, reaction;
    double *sums;
    if (map == NULL || map->coefficients == NULL || currents == NULL || fixed == NULL) return FIELDMAP_ARGUMENT;
    size = (size_t)map->size, sets = (size_t)fieldmap_sets(map);
    places = (size_t)map->cells[0] * (size_t)map->cells[1] * (size_t)map->cells[2];
    reaction = map->reaction == NULL ? 0 : places * size * (size_t)map->reacting;
    sums = (double *)malloc((places * size + reaction) * sizeof(double));
    if (sums == NULL) return FIELDMAP_NO_MEMORY;
    for (n = 0; n < places; n++)
        fieldmap_sum_sets(map, map->coefficients + n * sets * size, currents, sums + n * size);
    *fixed = *map;
    fixed->n_coils = 1;
    fixed->constant = fixed->linkage.coils = 0;
    fixed->names = NULL;
    fixed->coefficients = sums;
    fixed->owned = sums;
    if (reaction > 0) {
        memcpy(sums + places * size, map->reaction, reaction * sizeof(double));
        fixed->reaction = sums + places * size;
    }
    return FIELDMAP_OK;
}

#endif
