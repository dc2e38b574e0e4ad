/* The photographs in a folder, and their relation to a model: the file that a name of the model
 * means if it is written otherwise (.jpg and .JPG), and photographs that the model lacks.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "core/base.h"
#include "scene/control/table.h"
#include "scene/ingest/ingest_files.h"

enum { FILES_DEEP = 8 };

/* One of our scenes, or what lies beside photographs. */
static bool files_skip_folder(const char *path, const char *name)
{
    static const char *const names[] = {"masks", "sparse", "scene", "cells"};
    char marker[FILE_PATH_MAX];
    for (size_t k = 0; k < sizeof names / sizeof *names; k++)
        if (!strcmp(name, names[k]))
            return true;
    return file_join(marker, path, "scene.json", NULL) || file_exists(marker);
}

/* Whether a name ends like that of a photograph, and not like that of a mask. */
static bool ingest_files_is_photo(const char *name)
{
    static const char *const endings[] = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp"};
    const char *dot = strrchr(name, '.');
    for (size_t k = 0; dot && k < sizeof endings / sizeof *endings; k++)
        if (!strcasecmp(dot, endings[k])) {
            /* "a.jpg.png" is the mask of a.jpg. */
            size_t n = (size_t)(dot - name);
            for (size_t j = 0; j < sizeof endings / sizeof *endings; j++) {
                size_t m = strlen(endings[j]);
                if (n > m && !strncasecmp(name + n - m, endings[j], m))
                    return false;
            }
            return true;
        }
    return false;
}

static enum err_code files_add(struct ingest_files *f, const char *name, struct err *e)
{
    char **names = mem_room(f->names, f->n, &f->cap, 256, sizeof *names);
    if (!names)
        return err_set(e, ERR_MEM, "out of memory for a list of photographs");
    f->names = names;
    f->names[f->n] = mem_text(name);
    return f->names[f->n++] ? ERR_OK
                            : err_set(e, ERR_MEM, "out of memory for a list of photographs");
}

/* below: of the root, "" or "a/b". */
static enum err_code files_walk(struct ingest_files *f, const char *root, const char *below,
                                size_t deep, struct err *e)
{
    char path[FILE_PATH_MAX], name[FILE_PATH_MAX];
    enum err_code rc = file_join(path, root, below[0] ? below : ".", e);
    DIR *d = rc ? NULL : opendir(path);
    for (struct dirent *t; !rc && d && (t = readdir(d));) {
        struct stat st;
        if (t->d_name[0] == '.')
            continue;
        if (below[0])
            rc = file_join(name, below, t->d_name, e);
        else if (strlen(t->d_name) < sizeof name)
            memcpy(name, t->d_name, strlen(t->d_name) + 1);
        if (!rc)
            rc = file_join(path, root, name, e);
        if (rc)
            continue;
        if (stat(path, &st)) { /* a link that leads nowhere: whoever reads it says so */
            rc = ingest_files_is_photo(t->d_name) ? files_add(f, name, e) : ERR_OK;
            continue;
        }
        if (S_ISDIR(st.st_mode) && deep && !files_skip_folder(path, t->d_name))
            rc = files_walk(f, root, name, deep - 1, e);
        else if (S_ISREG(st.st_mode) && ingest_files_is_photo(t->d_name))
            rc = files_add(f, name, e);
    }
    if (d)
        closedir(d);
    return rc;
}

static int files_compare(const void *a, const void *b)
{
    char *const *p = a, *const *q = b;
    int order = strcasecmp(*p, *q); /* capitals beside each other */
    return order ? order : strcmp(*p, *q);
}

enum err_code ingest_files_list(const char *root, struct ingest_files *out, struct err *e)
{
    *out = (struct ingest_files){0};
    enum err_code rc = files_walk(out, root, "", FILES_DEEP, e);
    if (rc)
        ingest_files_free(out);
    else if (out->n)
        qsort(out->names, out->n, sizeof *out->names, files_compare);
    return rc;
}

void ingest_files_free(struct ingest_files *f)
{
    for (size_t i = 0; i < f->n; i++)
        mem_free(f->names[i]);
    mem_free(f->names);
    *f = (struct ingest_files){0};
}

/* Of a name that case alone does not lead to. */
static const char *files_find_alike(const struct ingest_files *f, const char *name)
{
    const char *found = NULL;
    size_t fits = 0;
    for (size_t i = 0; i < f->n; i++)
        if (table_same_path(f->names[i], name)) {
            found = f->names[i];
            fits++;
        }
    return fits == 1 ? found : NULL;
}

const char *ingest_files_find(const struct ingest_files *f, const char *name)
{
    size_t lo = 0, hi = f->n;
    const char *found = NULL;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (strcasecmp(f->names[mid], name) < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    for (; lo < f->n && !strcasecmp(f->names[lo], name); lo++) {
        if (!strcmp(f->names[lo], name))
            return f->names[lo];
        if (found)
            return NULL; /* two that differ in capitals: neither is meant for sure */
        found = f->names[lo];
    }
    return found ? found : files_find_alike(f, name);
}
