/* Control groups limit the memory of a container or a job: what counts is the tightest one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/machine.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base.h"

enum { MACHINE_LEAST = 1 << 20 };

enum err_code machine_memory_parse(const char *text, size_t machine, size_t *out, struct err *e)
{
    const char *end = text;
    *out = machine / 2;
    if (!strcmp(text, "auto"))
        return ERR_OK;
    double v, unit = 1;
    const bool is = number_read(&end, &v);
    if (*end == 'k' || *end == 'K')
        unit = 1 << 10, end++;
    else if (*end == 'M')
        unit = 1 << 20, end++;
    else if (*end == 'G')
        unit = 1 << 30, end++;
    if (!is || *end || !(v * unit >= MACHINE_LEAST) || v * unit > 1e15)
        return err_set(e, ERR_ARG,
                       "--memory %.40s: auto, or a size of at least 1M is expected: 512M, 2G",
                       text);
    *out = (size_t)(v * unit);
    return ERR_OK;
}

/* The number in a file; SIZE_MAX: none, or "max". */
static size_t machine_read(const char *path)
{
    unsigned long long v;
    FILE *f = fopen(path, "re");
    bool got = f && fscanf(f, "%llu", &v) == 1;
    if (f)
        fclose(f);
    return got && v < SIZE_MAX / 2 ? (size_t)v : SIZE_MAX;
}

/* The least limit of a group and those above it. The group's own path may be that of another
 * namespace; then the root's is found. */
static size_t machine_least(const char *root, const char *sub, const char *group, const char *name)
{
    char path[FILE_PATH_MAX], at[FILE_PATH_MAX];
    size_t least = SIZE_MAX;
    snprintf(at, sizeof at, "%s", group);
    for (char *slash = at; slash;) {
        snprintf(path, sizeof path, "%.1000s%s%.2000s/%s", root, sub, !strcmp(at, "/") ? "" : at,
                 name);
        const size_t limit = machine_read(path);
        least = limit < least ? limit : least;
        slash = strrchr(at, '/');
        if (slash && !at[1])
            break;
        if (slash)
            slash[slash == at] = '\0';
    }
    return least;
}

size_t machine_memory_limit(size_t physical, const char *cgroup, const char *root)
{
    char line[FILE_PATH_MAX];
    size_t least = physical;
    FILE *f = fopen(cgroup, "re");
    while (f && fgets(line, sizeof line, f)) {
        size_t limit = SIZE_MAX;
        char *kinds = strchr(line, ':'), *group = kinds ? strchr(kinds + 1, ':') : NULL;
        line[strcspn(line, "\n")] = '\0';
        if (!group || group[1] != '/')
            continue;
        *group++ = '\0';
        if (!kinds[1])
            limit = machine_least(root, "", group, "memory.max");
        else if (!strcmp(kinds + 1, "memory"))
            limit = machine_least(root, "/memory", group, "memory.limit_in_bytes");
        least = limit < least ? limit : least;
    }
    if (f)
        fclose(f);
    return least;
}

size_t machine_memory(void)
{
    const long pages = sysconf(_SC_PHYS_PAGES), size = sysconf(_SC_PAGESIZE);
    const size_t physical = pages > 0 && size > 0 ? (size_t)pages * (size_t)size : (size_t)1 << 30;
    return machine_memory_limit(physical, "/proc/self/cgroup", "/sys/fs/cgroup");
}
