/* Recorded runs as JSON lines: reading with a check, writing, looking up.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/study/runs.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

enum { RUNS_FILE_MAX = 64 << 20 }; /* bytes: recorded runs are small */

static enum err_code runs_add_line(const char *path, size_t number, const char *text, size_t n,
                                   json_t *lines, struct err *e)
{
    char name[FILE_PATH_MAX + 32];
    json_t *o = NULL;
    snprintf(name, sizeof name, "%s, line %zu", path, number);
    enum err_code rc = jsonc_parse(text, n, name, &o, e);
    if (!rc && !json_is_object(o)) {
        json_decref(o);
        return err_set(e, ERR_FORMAT, "%s: expected an object", name);
    }
    if (!rc && json_array_append_new(lines, o))
        rc = err_set(e, ERR_MEM, "%s: out of memory", name);
    return rc;
}

enum err_code runs_read_lines(const char *path, json_t **out, struct err *e)
{
    struct buf b = {0};
    json_t *lines = NULL;
    *out = NULL;
    enum err_code rc = file_read(path, RUNS_FILE_MAX, &b, e);
    if (!rc && !(lines = json_array()))
        rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    size_t number = 0;
    for (size_t at = 0; !rc && at < b.size;) {
        const char *line = (const char *)b.data + at;
        const char *end = memchr(line, '\n', b.size - at);
        size_t n = end ? (size_t)(end - line) : b.size - at;
        number++;
        if (n && line[0] == '{')
            rc = runs_add_line(path, number, line, n, lines, e);
        else if (n)
            rc = err_set(e, ERR_FORMAT, "%s, line %zu: expected a JSON object", path, number);
        at += n + 1;
    }
    buf_free(&b);
    if (rc) {
        json_decref(lines);
        return rc;
    }
    *out = lines;
    return ERR_OK;
}

enum err_code runs_read(const char *path, json_t **out, struct err *e)
{
    static const char *const texts[] = {"study", "row", "what"};
    size_t i;
    json_t *line;
    enum err_code rc = runs_read_lines(path, out, e);
    if (rc)
        return rc;
    json_array_foreach(*out, i, line)
    {
        for (size_t k = 0; !rc && k < sizeof texts / sizeof *texts; k++)
            if (!json_is_string(json_object_get(line, texts[k])))
                rc = err_set(e, ERR_FORMAT, "%s, record %zu: no text '%s'", path, i + 1, texts[k]);
        if (!rc && !json_is_object(json_object_get(line, "numbers")))
            rc = err_set(e, ERR_FORMAT, "%s, record %zu: no object 'numbers'", path, i + 1);
    }
    if (rc) {
        json_decref(*out);
        *out = NULL;
    }
    return rc;
}

enum err_code runs_write(const char *path, const json_t *lines, struct err *e)
{
    struct buf b = {0};
    size_t i;
    json_t *line;
    json_array_foreach(lines, i, line)
    {
        char *text = json_dumps(line, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(7));
        if (!text) {
            buf_free(&b);
            return err_set(e, ERR_MEM, "%s: out of memory", path);
        }
        buf_add(&b, text, strlen(text));
        buf_u8(&b, '\n');
        free(text); /* jansson's, made with malloc */
    }
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

const char *runs_text(const json_t *line, const char *key)
{
    const char *s = json_string_value(json_object_get(line, key));
    return s ? s : "";
}

double runs_number(const json_t *line, const char *key)
{
    const json_t *v = json_object_get(json_object_get(line, "numbers"), key);
    if (!v)
        v = json_object_get(line, key);
    return json_is_number(v) ? json_number_value(v) : (double)NAN;
}
