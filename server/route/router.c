/* See router.h. Later code uses a row, a dataset name that is compared with the catalog, and
 * numbers. No byte of a target becomes a path of a file. A valid path has no percent sign, no empty
 * or dotted segment and no byte outside [A-Za-z0-9/_.,@:-]. Anything else is refused here, and with
 * it traversal, NUL and encoding tricks.
 *
 * A path is compared with the template of one row after the other, in the order of the table. The
 * row of the viewer's files takes any path, so it is asked last. A bracket of a template is entered
 * where the path has its first character.
 *
 * The path is cut at its slashes once. A row whose template has another number of parts, or another
 * word in one of them, cannot match, so only rows with that number are looked at. Where none of
 * them matches, all are compared, for what they say about a path that is nearly theirs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/router.h"

#include <string.h>

#include "codec/splat/quant.h"

enum {
    ROUTER_PARAMS = 20,
    ROUTER_PARTS = 10,
    ROUTER_VALUE = 2048 /* as long as a target may be */
};

struct router_row {   /* what params.def says of a row of the table */
    uint8_t n[2];     /* parameters of the path, and of the query */
    uint8_t anchor;   /* in the template, the end of the last word between slashes, "/t/" */
    const char *form; /* the message about a path that fails behind the anchor; NULL: none */
    uint8_t n_parts;  /* of the template, between slashes; 0: any number */
    struct text word[ROUTER_PARTS]; /* [n_parts], p NULL: the part has a parameter */
    const struct param *param[2][ROUTER_PARAMS];
};
struct router {
    const struct route *rows;
    size_t n;
    struct router_row *row; /* [n] */
    /* Of each number of parts, 0: of all others, the rows that can match; in the table's order. */
    struct router_list {
        size_t n;
        uint16_t *row;
    } with[ROUTER_PARTS + 1];
};

/* ---- opening ---- */

/* The form of {name} that the groups of a row choose, else its only one. */
static const struct param *router_param(const char *name, size_t n, unsigned groups)
{
    const struct param *found = NULL;
    for (const struct param *p = PARAMS; p < PARAMS + PARAMS_COUNT; p++) {
        if (!(p->in & PARAM_PATH) || strlen(p->name) != n || memcmp(p->name, name, n) != 0)
            continue;
        if (p->in & groups)
            return p;
        if (p->in == PARAM_PATH)
            found = p;
    }
    return found;
}

/* The parts of a template and their words. Where a parameter or a bracket may hold a slash, there
 * is no fixed number of them. */
static void router_cut(struct router_row *row, const struct route *r)
{
    size_t n = 0;
    for (const char *p = r->path, *end; *p; p = end, n++) {
        const size_t size = strcspn(++p, "/");
        end = p + size;
        if (n == ROUTER_PARTS)
            return;
        if (!memchr(p, '{', size) && !memchr(p, '[', size))
            row->word[n] = (struct text){p, end};
        const char *open = memchr(p, '[', size), *close = memchr(p, ']', size);
        if (!open != !close)
            return;
    }
    for (uint8_t i = 0; i < row->n[0]; i++)
        if (row->param[0][i]->type == PARAM_SPAN || row->param[0][i]->type == PARAM_REST ||
            row->param[0][i]->type == PARAM_TEXT)
            return;
    row->n_parts = (uint8_t)n;
}

static enum err_code router_compile(struct router_row *row, const struct route *r, struct err *e)
{
    int depth = 0;
    const char *word = r->path, *p = r->path;
    for (; *p && depth >= 0; p++) {
        depth += (*p == '[') - (*p == ']');
        if (*p == '/' && p > word + 1 && *word == '/')
            row->anchor = (uint8_t)(p + 1 - r->path);
        word = strchr("{[]/", *p) ? p : word;
        if (*p != '{')
            continue;
        const size_t n = strcspn(++p, "}");
        const struct param *param = row->n[0] < ROUTER_PARAMS ? router_param(p, n, r->takes) : NULL;
        if (!param || (param->group != TARGET_names && !r->at[param->group]))
            return err_set(e, ERR_INTERNAL, "route %s: params.def has no {%.*s} of its groups",
                           r->name, (int)n, p);
        row->param[0][row->n[0]++] = param;
        row->form = strcmp(param->name, "rev") != 0 ? param->must : NULL;
        p += n;
    }
    if (r->size > sizeof(union target_any))
        return err_set(e, ERR_INTERNAL, "route %s: too large a target", r->name);
    if (depth || p - r->path > UINT8_MAX)
        return err_set(e, ERR_INTERNAL, "route %s: too long a template, or brackets", r->name);
    for (const struct param *q = PARAMS; q < PARAMS + PARAMS_COUNT; q++)
        if (q->in & r->takes && !(q->in & PARAM_PATH) && row->n[1] < ROUTER_PARAMS)
            row->param[1][row->n[1]++] = q;
    router_cut(row, r);
    return ERR_OK;
}

static enum err_code router_sort(struct router *r, struct err *e)
{
    for (size_t k = 0; k <= ROUTER_PARTS; k++) {
        struct router_list *l = &r->with[k];
        if (!(l->row = mem_array(r->n, sizeof *l->row)))
            return err_set(e, ERR_MEM, "routes: out of memory");
        for (size_t i = 0; i < r->n; i++)
            if (!(r->rows[i].scope & SCOPE_FILE) && (!r->row[i].n_parts || r->row[i].n_parts == k))
                l->row[l->n++] = (uint16_t)i;
    }
    return ERR_OK;
}

enum err_code router_open(const struct route *rows, size_t n, struct router **out, struct err *e)
{
    struct router *r = mem_array(1, sizeof *r);
    enum err_code rc = ERR_OK;
    *out = r;
    if (!r || !(r->row = mem_array(n, sizeof *r->row))) {
        router_close(out);
        return err_set(e, ERR_MEM, "routes: out of memory");
    }
    r->rows = rows;
    r->n = n;
    for (size_t i = 0; !rc && i < n; i++)
        rc = router_compile(&r->row[i], &rows[i], e);
    if (!rc)
        rc = router_sort(r, e);
    if (rc)
        router_close(out);
    return rc;
}

void router_close(struct router **r)
{
    for (size_t k = 0; *r && k <= ROUTER_PARTS; k++)
        mem_free((*r)->with[k].row);
    if (*r)
        mem_free((*r)->row);
    mem_free(*r);
    *r = NULL;
}

const struct route *router_rows(const struct router *r, size_t *n)
{
    *n = r->n;
    return r->rows;
}

size_t router_index(const struct router *r, const struct route *row)
{
    return row ? (size_t)(row - r->rows) : r->n;
}

size_t router_params(const struct router *r, const struct route *row, bool of_query,
                     const struct param *const **out)
{
    const struct router_row *x = &r->row[router_index(r, row)];
    *out = x->param[of_query];
    return x->n[of_query];
}

/* ---- paths ---- */

/* A letter, a digit, or one of _.,@:- */
static const bool router_of_part[256] = {
    [','] = 1, ['-'] = 1, ['.'] = 1, ['0'] = 1, ['1'] = 1, ['2'] = 1, ['3'] = 1, ['4'] = 1,
    ['5'] = 1, ['6'] = 1, ['7'] = 1, ['8'] = 1, ['9'] = 1, [':'] = 1, ['@'] = 1, ['A'] = 1,
    ['B'] = 1, ['C'] = 1, ['D'] = 1, ['E'] = 1, ['F'] = 1, ['G'] = 1, ['H'] = 1, ['I'] = 1,
    ['J'] = 1, ['K'] = 1, ['L'] = 1, ['M'] = 1, ['N'] = 1, ['O'] = 1, ['P'] = 1, ['Q'] = 1,
    ['R'] = 1, ['S'] = 1, ['T'] = 1, ['U'] = 1, ['V'] = 1, ['W'] = 1, ['X'] = 1, ['Y'] = 1,
    ['Z'] = 1, ['_'] = 1, ['a'] = 1, ['b'] = 1, ['c'] = 1, ['d'] = 1, ['e'] = 1, ['f'] = 1,
    ['g'] = 1, ['h'] = 1, ['i'] = 1, ['j'] = 1, ['k'] = 1, ['l'] = 1, ['m'] = 1, ['n'] = 1,
    ['o'] = 1, ['p'] = 1, ['q'] = 1, ['r'] = 1, ['s'] = 1, ['t'] = 1, ['u'] = 1, ['v'] = 1,
    ['w'] = 1, ['x'] = 1, ['y'] = 1, ['z'] = 1,
};

size_t router_unescape(char *text)
{
    char *to = text, *p = text;
    while (*p && *p != '?') {
        const int high = *p == '%' ? text_hex(p[1]) : -1, low = high < 0 ? -1 : text_hex(p[2]);
        const bool plain = low >= 0 && router_of_part[16 * high + low];
        *to++ = plain ? (char)(16 * high + low) : *p;
        p += plain ? 3 : 1;
    }
    const size_t rest = strlen(p);
    memmove(to, p, rest + 1);
    return (size_t)(to - text) + rest;
}

struct router_parts { /* of a path */
    size_t n;         /* more than ROUTER_PARTS: only the first are there */
    struct text part[ROUTER_PARTS];
};

/* Bytes no legal path needs, and no legal query: it is logged and repeated in Location. */
static enum err_code router_check(const char *p, size_t n_path, size_t n,
                                  struct router_parts *parts, struct err *e)
{
    const char *end = p + n_path, *slash = p;
    parts->n = 0;
    if (!n_path || p[0] != '/')
        return err_set(e, ERR_FORMAT, "the request target must be a path");
    while (slash < end) {
        const char *at = slash + 1;
        if (at < end && (*at == '/' || *at == '.'))
            return err_set(e, ERR_FORMAT,
                           "the path holds an empty segment or one that begins with a dot");
        while (at < end && router_of_part[(unsigned char)*at])
            at++;
        if (at < end && *at != '/')
            return err_set(e, ERR_FORMAT, "the path holds a byte that no path of this server has");
        if (parts->n++ < ROUTER_PARTS)
            parts->part[parts->n - 1] = (struct text){slash + 1, at};
        slash = at;
    }
    for (size_t i = n_path; i < n; i++)
        if (p[i] <= 0x20 || p[i] >= 0x7f)
            return err_set(e, ERR_FORMAT, "the query holds a byte that must be percent-encoded");
    return ERR_OK;
}

struct router_walk {
    const char *says; /* of the first row that says something about its form */
    enum err_code code;
    bool named; /* a row with parameters began like this path: it is no file */
};

/* Sets a parameter that was left out. */
static void router_leave_out(const struct param *p, struct target *out)
{
    if (p->standard) {
        struct text t = {p->standard, p->standard + strlen(p->standard)};
        (void)!param_read(p, &t, out, NULL);
    }
}

/* Leaves out what is between the bracket at p and the one that closes it, which is returned. n:
 * parameters before it. */
static const char *router_skip(const struct router_row *row, const char *p, uint8_t *n,
                               struct target *out)
{
    for (int depth = 1; depth;) {
        p++;
        depth += (*p == '[') - (*p == ']');
        if (*p == '{')
            router_leave_out(row->param[0][(*n)++], out);
    }
    return p;
}

/* Does the path match? ERR_NOENT: it does not. ERR_DATA: it does, with impossible numbers. */
static enum err_code router_match(const struct route *r, const struct router_row *row,
                                  struct text t, struct router_walk *w, struct target *out,
                                  struct err *e)
{
    uint8_t n = 0; /* parameters */
    const char *p = r->path;
    for (; *p; p++) {
        if (*p == '{') {
            const struct param *param = row->param[0][n];
            enum err_code rc = param_read(param, &t, out, e);
            w->named |= p > r->path + 1;
            if (rc == ERR_NOENT)
                break;
            if (rc)
                return rc;
            n++;
            p += strlen(param->name) + 1;
        } else if (*p == '[') {
            if (t.p == t.end || *t.p != p[1])
                p = router_skip(row, p, &n, out);
        } else if (*p != ']') {
            if (t.p == t.end || *t.p != *p)
                break;
            t.p++;
        }
    }
    if (!*p && text_at_end(&t))
        return ERR_OK;
    const char *says = *p == '{' && !strcmp(row->param[0][n]->name, "rev") ? row->param[0][n]->must
                       : row->anchor && p - r->path >= row->anchor         ? row->form
                                                                           : NULL;
    if (says && !w->says) {
        w->says = says;
        w->code = r->at[TARGET_view] ? ERR_FORMAT : ERR_NOENT;
    }
    return ERR_NOENT;
}

/* False: the row's words are not those of the path, so they cannot match. */
static bool router_may_match(const struct router_row *row, const struct router_parts *parts)
{
    size_t i = row->n_parts < parts->n ? row->n_parts : parts->n;
    while (i-- > 0) { /* the first words, d and r, are those of most rows */
        const struct text word = row->word[i], part = parts->part[i];
        const size_t n = (size_t)(word.end - word.p);
        if (word.p && ((size_t)(part.end - part.p) != n || memcmp(part.p, word.p, n) != 0))
            return false;
    }
    return true;
}

/* The target of a row, with nothing given. */
static void router_blank(const struct route *row, struct target *out)
{
    memset(out, 0, row->size);
    out->route = row;
    struct target_tiles *tiles = target_group(out, TARGET_tiles);
    struct target_cell *cell = target_group(out, TARGET_cell);
    if (tiles) {
        tiles->form.preset = QUANT_PRESETS;
        tiles->form.sh_degree = FORM_UNSAID;
    }
    if (cell)
        cell->scale = 1;
}

static enum err_code router_try(const struct router *r, size_t i, struct text t,
                                struct router_walk *w, struct target *out, struct err *e)
{
    router_blank(&r->rows[i], out);
    enum err_code rc = router_match(&r->rows[i], &r->row[i], t, w, out, e);
    out->route = rc ? NULL : out->route;
    return rc;
}

/* No row matches: the file's does, or what a row says about its form is the message. */
static enum err_code router_miss(const struct router *r, struct text t, struct target *out,
                                 struct err *e)
{
    const struct route *file = NULL;
    struct router_walk w = {.code = ERR_NOENT};
    for (size_t i = 0; i < r->n; i++) {
        if (r->rows[i].scope & SCOPE_FILE) {
            file = &r->rows[i];
            continue;
        }
        enum err_code rc = router_try(r, i, t, &w, out, e);
        if (rc != ERR_NOENT)
            return rc;
    }
    if (file && !w.named) {
        router_blank(file, out);
        return ERR_OK;
    }
    return err_set(e, w.code, "%s", w.says ? w.says : "there is nothing at this path");
}

static enum err_code router_find(const struct router *r, const struct router_parts *parts,
                                 struct text t, struct target *out, struct err *e)
{
    struct router_walk w = {.code = ERR_NOENT};
    const struct router_list *with = &r->with[parts->n <= ROUTER_PARTS ? parts->n : 0];
    for (size_t i = 0; i < with->n; i++) {
        const struct router_row *row = &r->row[with->row[i]];
        enum err_code rc = row->n_parts && !router_may_match(row, parts)
                               ? ERR_NOENT
                               : router_try(r, with->row[i], t, &w, out, e);
        if (rc != ERR_NOENT)
            return rc;
    }
    return router_miss(r, t, out, e);
}

/* ---- queries ---- */

struct router_query {
    const struct router_row *row;
    uint32_t seen; /* a bit a parameter */
};

static bool router_has(const struct router_query *q, const char *name)
{
    for (uint8_t i = 0; i < q->row->n[1]; i++)
        if (q->seen >> i & 1 && !strcmp(q->row->param[1][i]->name, name))
            return true;
    return false;
}

static enum err_code router_unknown(const struct router_row *row, struct err *e)
{
    struct buf names = {0};
    for (uint8_t i = 0; i < row->n[1]; i++)
        buf_printf(&names, "%s%s", i ? ", " : "", row->param[1][i]->name);
    enum err_code rc = err_set(e, ERR_FORMAT, "the query may hold %s, each once",
                               names.failed ? "some words" : (const char *)names.data);
    buf_free(&names);
    return rc;
}

/* The value of a parameter. A form writes %2C for a comma, and a plus for a space: that is a text's
 * own matter, and before a number it is its sign. */
static enum err_code router_take_value(const struct param *p, struct text value, struct target *out,
                                       struct err *e)
{
    char plain[ROUTER_VALUE];
    if (p->type != PARAM_TEXT && memchr(value.p, '%', (size_t)(value.end - value.p))) {
        if (!text_take_unescaped(&value, '+', plain, sizeof plain))
            return ERR_NOENT;
        value = (struct text){plain, plain + strlen(plain)};
    }
    enum err_code rc = param_read(p, &value, out, e);
    return !rc && !text_at_end(&value) ? ERR_NOENT : rc;
}

/* One part of a query. What it holds beside the parameters is for caches and not ours (Cesium adds
 * v=REVISION), but for lists, where a misspelt key would be a longer list, and for clip: a client
 * that asks for a part and gets all of it would not notice. */
static enum err_code router_take(struct router_query *q, struct text one, struct target *out,
                                 struct err *e)
{
    if (text_take(&one, "exp=") || text_take(&one, "key=") || text_take(&one, "scope=") ||
        text_take(&one, "sig="))
        return ERR_OK; /* of a signed address: auth.c */
    for (uint8_t i = 0; i < q->row->n[1]; i++) {
        const struct param *p = q->row->param[1][i];
        struct text value = one;
        if (!text_take(&value, p->name) || !text_take(&value, "="))
            continue;
        const bool again = q->seen >> i & 1;
        q->seen |= 1u << i;
        enum err_code rc = again ? ERR_NOENT : router_take_value(p, value, out, e);
        if (rc == ERR_NOENT)
            return err_set(e, ERR_FORMAT, "%s is %s, given once", p->name, p->must);
        return rc;
    }
    if (out->route->at[TARGET_page])
        return router_unknown(q->row, e);
    return out->route->scope & SCOPE_DATASET && text_take(&one, "clip=")
               ? err_set(e, ERR_FORMAT, "clip is of tiles, tilesets and prefetch lists")
               : ERR_OK;
}

/* What parameters say of each other. */
static enum err_code router_agree(const struct router_query *q, struct target *out, struct err *e)
{
    struct target_place *place = target_group(out, TARGET_place);
    if (place) {
        place->given = router_has(q, "lon");
        if (place->given != router_has(q, "lat"))
            return err_set(e, ERR_FORMAT, "lon and lat are given together");
    }
    return ERR_OK;
}

static enum err_code router_read_query(const struct router_row *row, struct text t,
                                       struct target *out, struct err *e)
{
    struct router_query q = {row, 0};
    for (uint8_t i = 0; i < row->n[1]; i++)
        router_leave_out(row->param[1][i], out);
    enum err_code rc = ERR_OK;
    while (!rc && !text_at_end(&t)) {
        const char *amp = memchr(t.p, '&', (size_t)(t.end - t.p));
        rc = router_take(&q, (struct text){t.p, amp ? amp : t.end}, out, e);
        t.p = amp ? amp + 1 : t.end;
    }
    return rc ? rc : router_agree(&q, out, e);
}

/* ---- both ---- */

/* What numbers of the path say of each other. */
static enum err_code router_check_path(struct target *out, struct err *e)
{
    const struct target_cell *cell = target_group(out, TARGET_cell);
    struct target_view *v = target_group(out, TARGET_view);
    if (cell && !key_valid(cell->key))
        return err_set(e, ERR_NOENT, "tile %u/%u/%u does not exist: z <= 24, x and y < 2^z",
                       cell->key.z, cell->key.x, cell->key.y);
    for (int k = 0; v && k < 2; k++) {
        uint32_t *side = k ? &v->height_px : &v->width_px;
        *side = (*side < TARGET_SIDE_MAX ? *side : TARGET_SIDE_MAX) * v->scale;
    }
    return ERR_OK;
}

enum err_code router_read(const struct router *r, const char *text, size_t n, union target_any *any,
                          struct err *e)
{
    struct target *out = &any->all;
    const char *mark = n ? memchr(text, '?', n) : NULL, *end = mark ? mark : text + n;
    struct router_parts parts;
    *out = (struct target){.route = NULL};
    enum err_code rc = router_check(text, (size_t)(end - text), n, &parts, e);
    if (!rc)
        rc = router_find(r, &parts, (struct text){text, end}, out, e);
    out->path_size = (size_t)(end - text);
    if (!rc)
        rc = router_check_path(out, e);
    return rc ? rc
              : router_read_query(&r->row[router_index(r, out->route)],
                                  (struct text){mark ? mark + 1 : end, text + n}, out, e);
}
