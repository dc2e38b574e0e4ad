/* Fills a config struct from defaults, config files and flags, by a table. One setter (options_set)
 * checks type and range for all three sources.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/options/options.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/options/options_completion.h"
#include "core/options/options_help.h"
#include "core/options/options_rules.h"

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

/* Factor of the suffix at `s`, 0 if it is none. In a unit of bytes a step is 1024 and the suffix
 * names bytes: G of MiB is 1024. A unit's own name may stand behind the number. */
static double options_suffix(const char *unit, const char *s)
{
    static const char steps[] = "kMGT";
    size_t n = strlen(unit);
    bool bytes = n >= 2 && n <= 3 && unit[n - 1] == 'B' && strchr("KMG", unit[0]);
    if (!*s)
        return 1.0;
    char letter = *s == 'K' ? 'k' : *s;
    const char *at = strchr(steps, letter);
    if (!at)
        return 0.0;
    double power = (double)(at - steps) + 1.0;
    if (!bytes)
        return s[1] ? 0.0 : pow(1000.0, power);
    if (s[1] && strcmp(s + 1, "B") && strcmp(s + 1, "iB"))
        return 0.0;
    const char *own = strchr(steps, *unit == 'K' ? 'k' : *unit);
    return pow(1024.0, power - ((double)(own - steps) + 1.0));
}

/* One value of a number or list: whole numbers in `whole`, others in `real`. */
static bool options_number(const struct options_def *d, const char *text, int64_t *whole,
                           double *real)
{
    bool is_whole = d->type == OPTIONS_INT || d->type == OPTIONS_INTS;
    char *end = NULL;
    errno = 0;
    if (!is_whole) {
        return number_list(text, 1, real) && *real >= d->lo && *real <= d->hi;
    }
    long long v = strtoll(text, &end, 10);
    if (end != text && !*end) {
        *whole = v;
        return !errno && (double)v >= d->lo && (double)v <= d->hi;
    }
    /* 1.5M and 4G: a decimal number and a suffix that together are whole. 0x10 and 1e3 are not. */
    if (text[strspn(text, "0123456789.")] == '\0' || !isdigit((unsigned char)*text))
        return false;
    size_t digits = strspn(text, "0123456789.");
    *real = strtod(text, &end);
    double v_scaled = *real * options_suffix(d->unit, text + digits);
    if (end != text + digits || v_scaled != floor(v_scaled) || v_scaled == 0.0 ||
        fabs(v_scaled) > 9007199254740992.0)
        return false;
    *whole = (int64_t)v_scaled;
    return v_scaled >= d->lo && v_scaled <= d->hi;
}

static void options_want_number(const struct options_def *d, char want[160])
{
    bool is_whole = d->type == OPTIONS_INT || d->type == OPTIONS_INTS;
    snprintf(want, 160, "a %snumber from %.15g to %.15g%s%s", is_whole ? "whole " : "", d->lo,
             d->hi, !is_whole && *d->unit ? " " : "", is_whole ? "" : d->unit);
}

static enum err_code options_set_number(const struct options_def *d, const char *text, void *config,
                                        struct err *e)
{
    char want[160];
    int64_t whole = 0;
    double real = 0.0;
    options_want_number(d, want);
    if (!options_number(d, text, &whole, &real))
        return options_bad(d, text, want, e);
    if (d->type == OPTIONS_INT)
        *(OPTIONS_C_INT *)options_at(d, config) = whole;
    else
        *(OPTIONS_C_NUM *)options_at(d, config) = real;
    return ERR_OK;
}

/* ---- lists ---- */

struct options_list { /* as read: one of the two is used */
    int64_t whole[OPTIONS_LIST_MAX];
    double real[OPTIONS_LIST_MAX];
    size_t n;
};

static enum err_code options_read_list(const struct options_def *d, const char *text, size_t most,
                                       struct options_list *l, struct err *e)
{
    char want[160], one[64];
    options_want_number(d, want);
    *l = (struct options_list){0};
    for (const char *p = text;; p++) {
        size_t n = strcspn(p, ",");
        if (l->n == most) {
            snprintf(want, sizeof want, "a list of at most %zu values: coarsest level first", most);
            return options_bad(d, text, want, e);
        }
        snprintf(one, sizeof one, "%.*s", (int)(n < sizeof one ? n : sizeof one - 1), p);
        if (!options_number(d, one, &l->whole[l->n], &l->real[l->n]))
            return options_bad(d, one, want, e);
        l->n++;
        p += n;
        if (!*p)
            return ERR_OK;
    }
}

static enum err_code options_set_list(const struct options_def *d, const char *text, void *config,
                                      struct err *e)
{
    struct options_list def, l;
    enum err_code rc = options_read_list(d, d->def, OPTIONS_LIST_MAX, &def, e);
    if (!rc)
        rc = options_read_list(d, text, def.n, &l, e);
    if (rc)
        return rc;
    bool same = l.n == def.n;
    for (size_t i = 0; same && i < l.n; i++)
        same = d->type == OPTIONS_INTS ? l.whole[i] == def.whole[i] : l.real[i] == def.real[i];
    size_t first = l.n > 1 ? def.n - l.n : def.n; /* one value leaves the default as it is */
    for (size_t i = first; i < def.n; i++) {
        def.whole[i] = l.whole[i - first];
        def.real[i] = l.real[i - first];
    }
    size_t n = same ? 0 : l.n;
    if (d->type == OPTIONS_INTS) {
        struct options_ints *o = options_at(d, config);
        *o = (struct options_ints){.one = n == 1 ? l.whole[0] : 0, .n = n};
        memcpy(o->v, def.whole, sizeof o->v);
    } else {
        struct options_nums *o = options_at(d, config);
        *o = (struct options_nums){.one = n == 1 ? l.real[0] : 0.0, .n = n};
        memcpy(o->v, def.real, sizeof o->v);
    }
    return ERR_OK;
}

static json_t *options_list_json(const struct options_def *d, const void *p)
{
    const struct options_ints *o = p;
    const struct options_nums *x = p;
    bool whole = d->type == OPTIONS_INTS;
    size_t n = whole ? o->n : x->n, most = 1;
    if (n == 1 || (whole ? o->one != 0 : x->one != 0.0))
        return whole ? json_integer(o->one) : json_real(x->one);
    for (const char *c = d->def; *c; c++)
        most += *c == ',';
    json_t *array = json_array();
    for (size_t i = n ? most - n : 0; array && i < most; i++)
        if (json_array_append_new(array, whole ? json_integer(o->v[i]) : json_real(x->v[i]))) {
            json_decref(array);
            return NULL;
        }
    return array;
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
        if (!*text && *d->def) { /* an unset variable of a script */
            char want[160];
            snprintf(want, sizeof want, "a value; leave the option out for its default, %s",
                     d->def);
            return options_bad(d, text, want, e);
        }
        if (*text && !copy)
            return err_set(e, ERR_MEM, "out of memory for options");
        *(OPTIONS_C_TEXT *)options_at(d, config) = copy;
        return ERR_OK;
    }
    case OPTIONS_INTS:
    case OPTIONS_NUMS:
        return options_set_list(d, text, config, e);
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

size_t options_distance(const char *a, const char *b)
{
    size_t row[OPTIONS_NAME_MAX + 1]; /* names are short: a row and a diagonal do */
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

/* budget_2, budget-2 and distance_1_m of older versions: the list that holds these values now. */
static const char *options_list_of(const struct options_spec *spec, const char *name, bool flag,
                                   char candidate[OPTIONS_NAME_MAX])
{
    char bare[OPTIONS_NAME_MAX];
    size_t n = 0, digits = 0;
    for (const char *p = name; *p && n + 1 < sizeof bare; p++) {
        bool digit = (*p == '-' || *p == '_') && p[1] >= '1' && p[1] <= '3' &&
                     (!p[2] || p[2] == '-' || p[2] == '_');
        if (digit)
            p++, digits++;
        else
            bare[n++] = *p;
    }
    bare[n] = '\0';
    for (size_t i = 0; digits == 1 && i < spec->n_defs; i++) {
        const struct options_def *d = &spec->defs[i];
        if (d->type != OPTIONS_INTS && d->type != OPTIONS_NUMS)
            continue;
        if (flag)
            options_help_flag(d->key, candidate);
        else
            snprintf(candidate, OPTIONS_NAME_MAX, "%s", d->key);
        if (!strcmp(bare, candidate))
            return candidate;
    }
    return NULL;
}

/* What to write instead of an option that left. NULL: it was never there. */
static const char *options_words_of_gone(const struct options_spec *spec, const char *name,
                                         bool *idle)
{
    static const struct {
        const char *command, *key, *words;
        bool idle;
    } gone[] = {
#define GONE(command, key, words) {command, key, words, false},
#define IDLE(command, key, words) {command, key, words, true},
#include "core/options/options_gone.def"
#undef GONE
#undef IDLE
    };
    char key[OPTIONS_NAME_MAX];
    snprintf(key, sizeof key, "%s", name);
    for (char *p = key; *p; p++)
        *p = *p == '-' ? '_' : *p;
    for (size_t i = 0; i < sizeof gone / sizeof *gone; i++)
        if (!strcmp(gone[i].key, key) &&
            (!*gone[i].command || !strcmp(gone[i].command, spec->command))) {
            *idle = gone[i].idle;
            return gone[i].words;
        }
    return NULL;
}

/* An option that left and does nothing; it is told if `tell`. */
static bool options_is_idle(const struct options_spec *spec, const char *name, bool tell)
{
    bool idle = false;
    const char *words = options_words_of_gone(spec, name, &idle);
    if (words && idle && tell)
        log_warn("options", "option %s is gone and does nothing: %s", name, words);
    return words && idle;
}

static enum err_code options_unknown(const struct options_spec *spec, const char *name, bool flag,
                                     struct err *e)
{
    bool idle;
    const char *gone = options_words_of_gone(spec, name, &idle);
    if (gone)
        return err_set(e, ERR_ARG, "option %s%s is gone: %s", flag ? "--" : "", name, gone);
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
    const char *list = options_list_of(spec, name, flag, candidate);
    if (list && flag)
        return err_set(e, ERR_ARG,
                       "unknown option --%s; --%s takes a list, coarsest level first: "
                       "--%s A,B,C",
                       name, list, list);
    if (list)
        return err_set(e, ERR_ARG,
                       "unknown option %s; %s takes a list, coarsest level first: "
                       "\"%s\": [A, B, C]",
                       name, list, list);
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

/* A word where a list stands: the option that takes it, as --budget fit of older versions. */
static enum err_code options_set_in(const struct options_spec *spec, const struct options_def *d,
                                    const char *text, void *config, struct arena *a, struct err *e)
{
    bool list = d->type == OPTIONS_INTS || d->type == OPTIONS_NUMS;
    for (size_t i = 0; list && i < spec->n_defs; i++) {
        const struct options_def *other = &spec->defs[i];
        char flag[OPTIONS_NAME_MAX], own[OPTIONS_NAME_MAX];
        if (other->type != OPTIONS_ENUM || strncmp(other->key, d->key, strlen(d->key)) ||
            options_choice(other->unit, text) < 0)
            continue;
        options_help_flag(other->key, flag);
        options_help_flag(d->key, own);
        return err_set(e, ERR_ARG, "--%s: '%s' is not a number; --%s takes it (%s in a file)", own,
                       text, flag, other->key);
    }
    return options_set(d, text, config, a, e);
}

/* [200, "1k", 0.5] as the text of a list; false if an element is none of these or has no room. */
static bool options_array_text(const json_t *v, char *out, size_t room)
{
    size_t at = 0;
    for (size_t i = 0; i < json_array_size(v); i++) {
        const json_t *x = json_array_get(v, i);
        char text[40];
        if (json_is_integer(x))
            snprintf(text, sizeof text, "%lld", (long long)json_integer_value(x));
        else if (json_is_real(x))
            snprintf(text, sizeof text, "%.17g", json_real_value(x));
        else if (json_is_string(x) && !strchr(json_string_value(x), ','))
            snprintf(text, sizeof text, "%s", json_string_value(x));
        else
            return false;
        int n = snprintf(out + at, room - at, "%s%s", i ? "," : "", text);
        if (n < 0 || (size_t)n >= room - at)
            return false;
        at += (size_t)n;
    }
    return at > 0;
}

static enum err_code options_set_json(const struct options_spec *spec, const struct options_def *d,
                                      const json_t *v, void *config, struct arena *a, struct err *e)
{
    char text[160];
    bool list = d->type == OPTIONS_INTS || d->type == OPTIONS_NUMS;
    if (list && json_is_array(v)) {
        if (!options_array_text(v, text, sizeof text))
            return err_set(e, ERR_ARG, "%s: an array of at most %d numbers is expected", d->key,
                           OPTIONS_LIST_MAX);
    } else if (json_is_integer(v))
        snprintf(text, sizeof text, "%lld", (long long)json_integer_value(v));
    else if (json_is_real(v))
        snprintf(text, sizeof text, "%.17g", json_real_value(v));
    else if (json_is_boolean(v))
        snprintf(text, sizeof text, "%s", json_is_true(v) ? "true" : "false");
    else if (json_is_string(v))
        return options_set_in(spec, d, json_string_value(v), config, a, e);
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
        rc = d ? options_set_json(spec, d, json_object_iter_value(it), config, a, e)
             : options_is_idle(spec, key, true) ? ERR_OK
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
        else if (d->type == OPTIONS_INTS || d->type == OPTIONS_NUMS)
            v = options_list_json(d, p);
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
    const char **arg; /* room for all of argv */
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
        return options_is_idle(w->spec, text, !w->files)
                   ? options_value(w, arg, inline_value, &value, e)
                   : options_unknown(w->spec, text, true, e);
    }
    enum err_code rc = options_value(w, arg, inline_value, &value, e);
    if (!rc && !w->files)
        rc = options_set_in(w->spec, d, value, w->config, w->arena, e);
    return rc;
}

/* -h, --help, --help=all, or --help=FORMAT with which `citysplat help` makes the reference, the
 * manual pages and the shell completion. */
static enum err_code options_ask_help(struct options_walk *w, const char *arg, struct err *e)
{
    static const char choices[] = "--help|--help=all|--help=markdown|--help=mdoc|"
                                  "--help=bash|--help=zsh|--help=fish";
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
    else if (!w->files)
        w->arg[w->args->n++] = arg;
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

/* The defaults as JSON. Their struct is as long as its last member. json_decref *out. */
static enum err_code options_defaults_json(const struct options_spec *spec, struct json_t **out,
                                           struct err *e)
{
    struct arena a = {0};
    size_t size = sizeof(struct options_nums);
    for (size_t i = 0; i < spec->n_defs; i++)
        if (spec->defs[i].offset + sizeof(struct options_nums) > size)
            size = spec->defs[i].offset + sizeof(struct options_nums);
    void *config = mem_array(1, size);
    enum err_code rc =
        config ? ERR_OK : err_set(e, ERR_MEM, "out of memory for the options' defaults");
    if (!rc)
        rc = options_defaults(spec, config, &a, e);
    if (!rc)
        rc = options_to_json(spec, config, out, e);
    mem_free(config);
    arena_free(&a);
    return rc;
}

static enum err_code options_check_rules(const struct options_spec *spec, const void *config,
                                         struct err *e)
{
    struct json_t *now = NULL, *defaults = NULL;
    enum err_code rc = options_to_json(spec, config, &now, e);
    if (!rc)
        rc = options_defaults_json(spec, &defaults, e);
    if (!rc)
        rc = options_rules_check(spec, now, defaults, e);
    json_decref(now);
    json_decref(defaults);
    return rc;
}

enum err_code options_parse(const struct options_spec *spec, int argc, char **argv, void *config,
                            struct options_args *args, struct arena *a, struct err *e)
{
    *args = (struct options_args){0};
    enum err_code rc = options_defaults(spec, config, a, e);
    struct options_walk w = {
        .spec = spec, .argc = argc, .argv = argv, .config = config, .args = args, .arena = a};
    if (!rc && !(args->arg = w.arg = arena_get(a, (size_t)argc, sizeof *w.arg)))
        rc = err_set(e, ERR_MEM, "options: out of memory");
    if (!rc)
        rc = options_pass(&w, true, e);
    if (!rc && !w.help)
        rc = options_pass(&w, false, e);
    if (w.help) {
        if (w.format >= OPTIONS_FORMAT_BASH)
            options_completion_print(stdout, spec, w.format);
        else
            options_help_print(stdout, spec, w.format);
        args->done = true;
        return ERR_OK;
    }
    if (!rc && w.print) {
        args->done = true;
        return options_print_config(spec, config, e);
    }
    if (!rc)
        rc = options_check_rules(spec, config, e);
    if (!rc && args->n < spec->min_args)
        rc = err_set(e, ERR_ARG, "too few arguments; usage: %s", spec->usage);
    if (!rc && args->n > spec->max_args)
        rc = err_set(e, ERR_ARG, "'%s' is one argument too many; usage: %s",
                     args->arg[spec->max_args], spec->usage);
    return rc;
}

enum err_code options_number_of(const char *option, const char *text, double none, double *out,
                                struct err *e)
{
    *out = none;
    return !text || number_list(text, 1, out)
               ? ERR_OK
               : err_set(e, ERR_ARG, "%s: '%s': a number is expected", option, text);
}
