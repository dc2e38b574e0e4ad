/* What the arguments of a step were made of. See city_inputs.h.
 *
 * Photographs are not read: a survey has gigabytes of them. Times do not count: whoever copies a
 * folder changes them all.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "cli/city_inputs.h"

enum { INPUTS_DEEP = 16 /* folders in folders */ };

static enum err_code inputs_folder(const char *dir, int deep, struct buf *out, struct err *e);

static bool inputs_is_model(const char *name)
{
    const char *dot = strrchr(name, '.');
    return dot && (!strcmp(dot, ".bin") || !strcmp(dot, ".txt"));
}

static enum err_code inputs_file(const char *path, struct buf *out, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = file_read(path, 0, &b, e);
    if (!rc) {
        const struct hash128 h = hash_bytes(b.data, b.size);
        buf_add(out, &h, sizeof h);
    }
    buf_free(&b);
    return rc;
}

static enum err_code inputs_entry(const char *dir, const char *name, int deep, struct buf *out,
                                  struct err *e)
{
    char path[FILE_PATH_MAX];
    struct stat st;
    enum err_code rc = file_join(path, dir, name, e);
    if (rc || stat(path, &st))
        return rc; /* a link to nothing */
    buf_add(out, name, strlen(name) + 1);
    if (S_ISDIR(st.st_mode))
        return inputs_folder(path, deep + 1, out, e);
    const int64_t size = st.st_size;
    buf_add(out, &size, sizeof size);
    return S_ISREG(st.st_mode) && inputs_is_model(name) ? inputs_file(path, out, e) : ERR_OK;
}

static enum err_code inputs_folder(const char *dir, int deep, struct buf *out, struct err *e)
{
    struct dirent **list = NULL;
    if (deep > INPUTS_DEEP)
        return ERR_OK;
    const int n = scandir(dir, &list, NULL, alphasort);
    enum err_code rc = n < 0 ? err_errno(e, ERR_IO, "%s", dir) : ERR_OK;
    for (int i = 0; i < n; i++) {
        if (!rc && list[i]->d_name[0] != '.')
            rc = inputs_entry(dir, list[i]->d_name, deep, out, e);
        free(list[i]); /* scandir's own */
    }
    free(list);
    return rc;
}

static enum err_code inputs_hash(const char *arg, struct buf *out, struct err *e)
{
    struct buf held = {0};
    struct stat st;
    char hash[33];
    if (stat(arg, &st) || !(S_ISREG(st.st_mode) || S_ISDIR(st.st_mode)))
        return ERR_OK;
    enum err_code rc =
        S_ISDIR(st.st_mode) ? inputs_folder(arg, 0, &held, e) : inputs_file(arg, &held, e);
    if (!rc)
        rc = buf_check(&held, e);
    if (!rc) {
        hash_text(hash_bytes(held.data, held.size), hash);
        buf_printf(out, "\n%s %s", hash, arg);
    }
    buf_free(&held);
    return rc;
}

enum err_code city_inputs_tell(const char *const *args, size_t n, struct buf *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < n; i++)
        buf_printf(out, "%s%s", i ? " " : "", args[i]);
    for (size_t i = 0; !rc && i < n; i++)
        rc = inputs_hash(args[i], out, e);
    return rc ? rc : buf_check(out, e);
}

/* The next line of b, which begins at *at; *n: its bytes. NULL: there is none. */
static const char *inputs_line(const struct buf *b, size_t *at, size_t *n)
{
    if (*at >= b->size)
        return NULL;
    const char *line = (const char *)b->data + *at;
    const char *end = memchr(line, '\n', b->size - *at);
    *n = end ? (size_t)(end - line) : b->size - *at;
    *at += *n + 1;
    return line;
}

enum err_code city_inputs_same(const char *made, const struct buf *was, const struct buf *now,
                               struct err *e)
{
    static const char way[] = "give another -o for another city, or --overwrite to make it anew, "
                              "which removes what was trained";
    enum { SHOWN = 400, DIGITS = 33 };
    size_t at_was = 0, at_now = 0, n_was = 0, n_now = 0;
    const char *a = inputs_line(was, &at_was, &n_was), *b = inputs_line(now, &at_now, &n_now);
    if (!a || n_was != n_now || memcmp(a, b, n_was))
        return err_set(e, ERR_ARG, "%s was made with other options (%.*s): %s", made,
                       (int)(n_was < SHOWN ? n_was : SHOWN), a ? a : "", way);
    while ((a = inputs_line(was, &at_was, &n_was)) && (b = inputs_line(now, &at_now, &n_now)))
        if (n_was != n_now || memcmp(a, b, n_was))
            return err_set(e, ERR_ARG, "%.*s has changed since %s was made of it: %s",
                           n_now > DIGITS ? (int)(n_now - DIGITS < SHOWN ? n_now - DIGITS : SHOWN)
                                          : 0,
                           n_now > DIGITS ? b + DIGITS : b, made, way);
    return ERR_OK;
}
