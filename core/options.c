/* Options from defaults, config files and flags into a config struct described by a table. One
 * setter (options_set) checks type and range for all three sources, so a rule cannot hold for one
 * and not another.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/options.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/options_help.h"

static void *options_at(const struct options_def *d, void *config)
{
    return (char *)config + d->offset;
}

static const void *options_const_at(const struct options_def *d, const void *config)
{
    return (const char *)config + d->offset;
}

/* Index of `text` among "a|b|c", or -1. */
static int options_choice(const char *choices, const char *text)
{
    size_t n = strlen(text);
    int index = 0;
    for (const char *p = choices; *p; index++) {
        size_t m = strcspn(p, "|");
        if (m == n && !memcmp(p, text, n))
            return index;
        p += m + (p[m] == '|');
    }
    return -1;
}

static enum err_code options_bad(const struct options_def *d, const char *text, const char *want,
                                 struct err *e)
{
    char flag[OPTIONS_NAME_MAX];
    options_help_flag(d->key, flag);
    return err_set(e, ERR_ARG, "--%s: '%s' is not %s", flag, text, want);
}

static enum err_code options_set_number(const struct options_def *d, const char *text, void *config,
                                        struct err *e)
{
    char *end = NULL;
    errno = 0;
    char want[160];
    if (d->type == OPTIONS_INT) {
        long long v = strtoll(text, &end, 10);
        snprintf(want, sizeof want, "a whole number from %.15g to %.15g", d->lo, d->hi);
        if (end == text || *end || errno || !((double)v >= d->lo && (double)v <= d->hi))
            return options_bad(d, text, want, e);
        *(OPTIONS_C_INT *)options_at(d, config) = v;
        return ERR_OK;
    }
    double v = strtod(text, &end);
    snprintf(want, sizeof want, "a number from %.15g to %.15g%s%s", d->lo, d->hi,
             *d->unit ? " " : "", d->unit);
    if (end == text || *end || !isfinite(v) || !(v >= d->lo && v <= d->hi))
        return options_bad(d, text, want, e);
    *(OPTIONS_C_NUM *)options_at(d, config) = v;
    return ERR_OK;
}

static enum err_code options_set(const struct options_def *d, const char *text, void *config,
                                 struct arena *a, struct err *e)
{
    switch (d->type) {
    case OPTIONS_NUM:
    case OPTIONS_INT:
        return options_set_number(d, text, config, e);
    case OPTIONS_BOOL:
        if (strcmp(text, "true") && strcmp(text, "false"))
            return options_bad(d, text, "true or false", e);
        *(OPTIONS_C_BOOL *)options_at(d, config) = text[0] == 't';
        return ERR_OK;
    case OPTIONS_ENUM: {
        int i = options_choice(d->unit, text);
        char want[160];
        snprintf(want, sizeof want, "one of %s", d->unit);
        if (i < 0)
            return options_bad(d, text, want, e);
        *(OPTIONS_C_ENUM *)options_at(d, config) = i;
        return ERR_OK;
    }
    case OPTIONS_TEXT: {
        char *copy = *text ? arena_text(a, text) : NULL;
        if (*text && !copy)
            return err_set(e, ERR_MEM, "out of memory for options");
        *(OPTIONS_C_TEXT *)options_at(d, config) = copy;
        return ERR_OK;
    }
    case OPTIONS_GROUP:
        return ERR_OK;
    }
    return err_set(e, ERR_INTERNAL, "option %s has an unknown type", d->key);
}

enum err_code options_defaults(const struct options_spec *spec, void *config, struct arena *a,
                               struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < spec->n_defs; i++)
        rc = options_set(&spec->defs[i], spec->defs[i].def, config, a, e);
    return rc;
}

/* Levenshtein distance, for "did you mean". Names are short; two rows suffice. */
static size_t options_distance(const char *a, const char *b)
{
    size_t row[OPTIONS_NAME_MAX + 1];
    size_t n = strlen(b);
    if (n > OPTIONS_NAME_MAX)
        return SIZE_MAX;
    for (size_t j = 0; j <= n; j++)
        row[j] = j;
    for (size_t i = 0; a[i]; i++) {
        size_t diagonal = row[0];
        row[0] = i + 1;
        for (size_t j = 0; j < n; j++) {
            size_t cost = diagonal + (a[i] != b[j]);
            diagonal = row[j + 1];
            size_t best = row[j] < row[j + 1] ? row[j] + 1 : row[j + 1] + 1;
            row[j + 1] = best < cost ? best : cost;
        }
    }
    return row[n];
}

static enum err_code options_unknown(const struct options_spec *spec, const char *name, bool flag,
                                     struct err *e)
{
    char best[OPTIONS_NAME_MAX] = "", candidate[OPTIONS_NAME_MAX];
    size_t best_d = SIZE_MAX;
    for (size_t i = 0; i < spec->n_defs; i++) {
        if (spec->defs[i].type == OPTIONS_GROUP)
            continue;
        if (flag)
            options_help_flag(spec->defs[i].key, candidate);
        else
            snprintf(candidate, sizeof candidate, "%s", spec->defs[i].key);
        size_t d = options_distance(name, candidate);
        if (d < best_d) {
            best_d = d;
            memcpy(best, candidate, sizeof best);
        }
    }
    const char *dash = flag ? "--" : "";
    if (best_d <= strlen(name) / 2 + 1)
        return err_set(e, ERR_ARG, "unknown option %s%s; did you mean %s%s?", dash, name, dash,
                       best);
    return err_set(e, ERR_ARG, "unknown option %s%s", dash, name);
}

static const struct options_def *options_find(const struct options_spec *spec, const char *flag,
                                              size_t n)
{
    for (size_t i = 0; i < spec->n_defs; i++) {
        char name[OPTIONS_NAME_MAX];
        options_help_flag(spec->defs[i].key, name);
        if (n && strlen(name) == n && !memcmp(name, flag, n))
            return &spec->defs[i];
    }
    return NULL;
}

static enum err_code options_set_json(const struct options_def *d, const json_t *v, void *config,
                                      struct arena *a, struct err *e)
{
    char text[64];
    if (json_is_integer(v))
        snprintf(text, sizeof text, "%lld", (long long)json_integer_value(v));
    else if (json_is_real(v))
        snprintf(text, sizeof text, "%.17g", json_real_value(v));
    else if (json_is_boolean(v))
        snprintf(text, sizeof text, "%s", json_is_true(v) ? "true" : "false");
    else if (json_is_string(v))
        return options_set(d, json_string_value(v), config, a, e);
    else
        return err_set(e, ERR_ARG, "%s: a number, text or true/false is expected", d->key);
    return options_set(d, text, config, a, e);
}

enum err_code options_from_json(const struct options_spec *spec, const struct json_t *o,
                                void *config, struct arena *a, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (!json_is_object(o))
        return err_set(e, ERR_ARG, "an object { \"key\": value } is expected");
    for (void *it = json_object_iter((json_t *)(uintptr_t)o); it && !rc;
         it = json_object_iter_next((json_t *)(uintptr_t)o, it)) {
        const char *key = json_object_iter_key(it);
        const struct options_def *d = NULL;
        for (size_t i = 0; i < spec->n_defs; i++)
            if (*key && !strcmp(spec->defs[i].key, key))
                d = &spec->defs[i];
        rc = d ? options_set_json(d, json_object_iter_value(it), config, a, e)
               : options_unknown(spec, key, false, e);
    }
    return rc;
}

static enum err_code options_config_file(const struct options_spec *spec, const char *path,
                                         void *config, struct arena *a, struct err *e)
{
    struct json_t *root = NULL;
    enum err_code rc = jsonc_read(path, &root, e);
    if (!rc && options_from_json(spec, root, config, a, e))
        rc = err_add(e, "%s", path);
    json_decref(root);
    return rc;
}

enum err_code options_to_json(const struct options_spec *spec, const void *config,
                              struct json_t **out, struct err *e)
{
    json_t *o = json_object();
    bool bad = !o;
    for (size_t i = 0; !bad && i < spec->n_defs; i++) {
        const struct options_def *d = &spec->defs[i];
        const void *p = options_const_at(d, config);
        json_t *v = NULL;
        if (d->type == OPTIONS_GROUP)
            continue;
        if (d->type == OPTIONS_NUM)
            v = json_real(*(const OPTIONS_C_NUM *)p);
        else if (d->type == OPTIONS_INT)
            v = json_integer(*(const OPTIONS_C_INT *)p);
        else if (d->type == OPTIONS_BOOL)
            v = json_boolean(*(const OPTIONS_C_BOOL *)p);
        else if (d->type == OPTIONS_TEXT) {
            const char *s = *(const OPTIONS_C_TEXT *)p;
            v = json_string(s ? s : "");
        } else {
            const char *c = d->unit;
            for (int k = *(const OPTIONS_C_ENUM *)p; k > 0 && *c; k--)
                c += strcspn(c, "|") + 1;
            v = json_stringn(c, strcspn(c, "|"));
        }
        bad = !v || json_object_set_new(o, d->key, v);
    }
    if (bad) {
        json_decref(o);
        return err_set(e, ERR_MEM, "out of memory for the options' JSON");
    }
    *out = o;
    return ERR_OK;
}

/* ---- flags ---- */

struct options_walk { /* where the walk over argv is */
    const struct options_spec *spec;
    int argc, at;
    char **argv;
    void *config;
    struct options_args *args;
    struct arena *arena;
    bool help, print;
    enum options_format format; /* of the help */
    bool files;                 /* this pass reads --config only; the other pass everything else */
};

static enum err_code options_value(struct options_walk *w, const char *flag,
                                   const char *inline_value, const char **out, struct err *e)
{
    if (inline_value) {
        *out = inline_value;
        return ERR_OK;
    }
    if (w->at + 1 >= w->argc)
        return err_set(e, ERR_ARG, "%s: a value is expected after it", flag);
    *out = w->argv[++w->at];
    return ERR_OK;
}

static enum err_code options_long(struct options_walk *w, const char *arg, struct err *e)
{
    const char *name = arg + 2;
    size_t n = strcspn(name, "=");
    const char *inline_value = name[n] == '=' ? name + n + 1 : NULL;
    const char *value = NULL;
    if (n == 6 && !memcmp(name, "config", 6)) {
        enum err_code rc = options_value(w, "--config", inline_value, &value, e);
        if (!rc && w->files)
            rc = options_config_file(w->spec, value, w->config, w->arena, e);
        return rc;
    }
    const struct options_def *d = options_find(w->spec, name, n);
    if (d && d->type == OPTIONS_BOOL)
        return w->files
                   ? ERR_OK
                   : options_set(d, inline_value ? inline_value : "true", w->config, w->arena, e);
    if (!d && n > 3 && !memcmp(name, "no-", 3)) {
        d = options_find(w->spec, name + 3, n - 3);
        if (d && d->type == OPTIONS_BOOL && !inline_value)
            return w->files ? ERR_OK : options_set(d, "false", w->config, w->arena, e);
        d = NULL;
    }
    if (!d) {
        char text[OPTIONS_NAME_MAX];
        snprintf(text, sizeof text, "%.*s", (int)(n < sizeof text ? n : sizeof text - 1), name);
        return options_unknown(w->spec, text, true, e);
    }
    enum err_code rc = options_value(w, arg, inline_value, &value, e);
    if (!rc && !w->files)
        rc = options_set(d, value, w->config, w->arena, e);
    return rc;
}

/* -h, --help, or --help=FORMAT with which `citysplat help` makes the reference. */
static enum err_code options_ask_help(struct options_walk *w, const char *arg, struct err *e)
{
    static const char choices[] = "--help|--help=markdown|--help=mdoc";
    int format = options_choice(choices, strcmp(arg, "-h") ? arg : "--help");
    if (format < 0)
        return options_unknown(w->spec, arg + 2, true, e);
    w->help = true;
    w->format = (enum options_format)format;
    return ERR_OK;
}

static enum err_code options_one(struct options_walk *w, struct err *e)
{
    const char *arg = w->argv[w->at];
    bool number = arg[0] == '-' && (isdigit((unsigned char)arg[1]) || arg[1] == '.');
    if (!strcmp(arg, "-h") || !strncmp(arg, "--help", 6))
        return options_ask_help(w, arg, e);
    else if (!strcmp(arg, "--print-config"))
        w->print = true;
    else if (!strcmp(arg, "-v"))
        log_set_level(LOG_DEBUG);
    else if (!strcmp(arg, "-q")) {
        log_set_level(LOG_WARN);
        progress_quiet(true);
    } else if (!strcmp(arg, "-o")) {
        if (!options_find(w->spec, "output", 6))
            return options_unknown(w->spec, "o", true, e);
        const char *value = NULL;
        enum err_code rc = options_value(w, "-o", NULL, &value, e);
        if (rc || w->files)
            return rc;
        return options_set(options_find(w->spec, "output", 6), value, w->config, w->arena, e);
    } else if (arg[0] == '-' && arg[1] == '-')
        return options_long(w, arg, e);
    else if (arg[0] == '-' && arg[1] && !number)
        return err_set(e, ERR_ARG, "unknown option %s", arg);
    else if (!w->files) {
        if (w->args->n == sizeof w->args->arg / sizeof w->args->arg[0])
            return err_set(e, ERR_ARG, "too many arguments, from '%s' on", arg);
        w->args->arg[w->args->n++] = arg;
    }
    return ERR_OK;
}

/* Two passes over argv: config files first, then flags, so that a flag wins wherever it stands. */
static enum err_code options_pass(struct options_walk *w, bool files, struct err *e)
{
    w->files = files;
    enum err_code rc = ERR_OK;
    for (w->at = 1; !rc && w->at < w->argc; w->at++)
        rc = options_one(w, e);
    return rc;
}

static enum err_code options_print_config(const struct options_spec *spec, const void *config,
                                          struct err *e)
{
    struct json_t *o = NULL;
    enum err_code rc = options_to_json(spec, config, &o, e);
    if (rc)
        return rc;
    json_dumpf(o, stdout, JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(12));
    putchar('\n');
    json_decref(o);
    return ERR_OK;
}

enum err_code options_parse(const struct options_spec *spec, int argc, char **argv, void *config,
                            struct options_args *args, struct arena *a, struct err *e)
{
    *args = (struct options_args){0};
    enum err_code rc = options_defaults(spec, config, a, e);
    struct options_walk w = {
        .spec = spec, .argc = argc, .argv = argv, .config = config, .args = args, .arena = a};
    if (!rc)
        rc = options_pass(&w, true, e);
    if (!rc && !w.help)
        rc = options_pass(&w, false, e);
    if (w.help) {
        options_help_print(stdout, spec, w.format);
        args->done = true;
        return ERR_OK;
    }
    if (!rc && w.print) {
        args->done = true;
        return options_print_config(spec, config, e);
    }
    if (!rc && args->n < spec->min_args)
        rc = err_set(e, ERR_ARG, "too few arguments; usage: %s", spec->usage);
    if (!rc && args->n > spec->max_args)
        rc = err_set(e, ERR_ARG, "'%s' is one argument too many; usage: %s",
                     args->arg[spec->max_args], spec->usage);
    return rc;
}
