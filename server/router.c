/* See router.h. Later code uses a row, a dataset name that is compared with the catalog, and
 * numbers. No byte of a target becomes a path of a file. A valid path has no percent sign, no empty
 * or dotted segment and no byte outside [A-Za-z0-9/_.,@:-]. Anything else is refused here, and with
 * it traversal, NUL and encoding tricks.
 *
 * Templates are cut into pieces when the router is opened: literals, parameters, and optional
 * parts. Rows are sorted, so that rows with the same beginning are neighbours. Matching a row
 * starts where it differs from the row before, and skips it if that row failed earlier.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/router.h"

#include <stdlib.h>
#include <string.h>

#include "codec/quant.h"

enum { ROUTER_PIECES = 32, ROUTER_QUERY = 20 };

struct router_piece { /* a literal, a parameter, or a beginning of what may be left out */
    const char *text; /* [n]; NULL: no literal */
    size_t n;
    const struct param *param; /* NULL: no parameter */
    uint8_t skip; /* the piece behind the end of what may be left out; 0: none begins */
};
struct router_row {
    const struct route *route;
    struct router_piece piece[ROUTER_PIECES];
    uint8_t n, same; /* pieces; of these as in the row before */
    uint8_t anchor;  /* the last literal of a whole word, "/t/" */
    uint8_t n_path, n_query, n_documented;
    bool keyed;           /* it has {z}/{x}/{y} */
    const char *form;     /* what is said of a path that fails behind the anchor; NULL: nothing */
    uint32_t n_beginning; /* rows with the same first piece */
    const struct param *path[ROUTER_PIECES], *query[ROUTER_QUERY];
};
struct router {
    const struct route *rows;
    size_t n;
    struct router_row *row;       /* [n], sorted */
    const struct router_row **of; /* [n], in the order of rows */
};

/* ---- opening ---- */

/* The form of {name} that the groups of a row choose, else its only one. */
static const struct param *router_param(const char *name, size_t n, unsigned groups)
{
    const struct param *found = NULL;
    for (size_t i = 0; i < PARAMS_COUNT; i++) {
        const struct param *p = &PARAMS[i];
        if (!(p->groups & PARAM_PATH) || strlen(p->name) != n || memcmp(p->name, name, n) != 0)
            continue;
        if (p->groups & groups)
            return p;
        if (p->groups == PARAM_PATH)
            found = p;
    }
    return found;
}

static enum err_code router_cut(struct router_row *row, struct err *e)
{
    uint8_t open[4], depth = 0;
    for (const char *p = row->route->path; *p;) {
        struct router_piece piece = {0};
        if (row->n == ROUTER_PIECES || depth == sizeof open || (*p == ']' && !depth))
            return err_set(e, ERR_INTERNAL, "route %s: too long a template, or brackets",
                           row->route->name);
        if (*p == ']') {
            row->piece[open[--depth]].skip = row->n;
            p++;
            continue;
        }
        if (*p == '[') {
            open[depth++] = row->n;
            p++;
        } else if (*p == '{') {
            piece.n = strcspn(++p, "}");
            piece.param = router_param(p, piece.n, row->route->query);
            if (!piece.param)
                return err_set(e, ERR_INTERNAL, "route %s: params.def has no {%.*s} of paths",
                               row->route->name, (int)piece.n, p);
            row->path[row->n_path++] = piece.param;
            p += piece.n + (p[piece.n] == '}');
        } else {
            piece.n = strcspn(p, "{[]");
            piece.text = p;
            p += piece.n;
            if (piece.n > 2 && *piece.text == '/' && p[-1] == '/')
                row->anchor = row->n;
        }
        row->piece[row->n++] = piece;
    }
    return depth ? err_set(e, ERR_INTERNAL, "route %s: a bracket has no end", row->route->name)
                 : ERR_OK;
}

static enum err_code router_compile(struct router_row *row, const struct route *r, struct err *e)
{
    row->route = r;
    enum err_code rc = router_cut(row, e);
    if (rc)
        return rc;
    for (uint8_t i = 0; i < row->n_path; i++)
        row->keyed |= !strcmp(row->path[i]->name, "z");
    const struct param *last = row->n_path ? row->path[row->n_path - 1] : NULL;
    row->form = last && strcmp(last->name, "rev") != 0 ? last->must : NULL;
    /* A client that asks for a part and gets all of it would not notice: clip is refused. */
    const bool refuses_clip =
        r->scope & SCOPE_DATASET && !(r->query & (QUERY_TILES | QUERY_STRICT));
    for (size_t i = 0; i < PARAMS_COUNT; i++)
        if (PARAMS[i].groups & r->query && !(PARAMS[i].groups & PARAM_PATH) &&
            row->n_query < ROUTER_QUERY)
            row->query[row->n_query++] = &PARAMS[i];
    row->n_documented = row->n_query;
    for (size_t i = 0; refuses_clip && i < PARAMS_COUNT; i++)
        if (!strcmp(PARAMS[i].name, "clip"))
            row->query[row->n_query++] = &PARAMS[i];
    return ERR_OK;
}

static bool router_same_piece(const struct router_piece *a, const struct router_piece *b)
{
    return a->n == b->n && a->param == b->param && a->skip == b->skip && !a->text == !b->text &&
           (!a->text || !memcmp(a->text, b->text, a->n));
}

/* Most requests are for what most rows begin with. "/{file}" takes anything, so it is the last. */
static int router_by_path(const void *pa, const void *pb)
{
    const struct router_row *a = pa, *b = pb;
    if (a->n_beginning != b->n_beginning)
        return a->n_beginning > b->n_beginning ? -1 : 1;
    return strcmp(a->route->path, b->route->path);
}

static void router_sort(struct router *r)
{
    for (size_t i = 0; i < r->n; i++)
        for (size_t j = 0; j < r->n; j++)
            r->row[i].n_beginning += router_same_piece(r->row[i].piece, r->row[j].piece);
    for (size_t i = 0; i < r->n; i++)
        if (r->row[i].n > 1 && r->row[i].piece[1].param &&
            r->row[i].piece[1].param->type == PARAM_REST)
            r->row[i].n_beginning = 0;
    qsort(r->row, r->n, sizeof *r->row, router_by_path);
    for (size_t i = 0; i < r->n; i++) {
        struct router_row *row = &r->row[i];
        r->of[row->route - r->rows] = row;
        while (i && row->same < row->n && row->same < row[-1].n && !row->piece[row->same].skip &&
               router_same_piece(&row->piece[row->same], &row[-1].piece[row->same]))
            row->same++;
    }
}

enum err_code router_open(const struct route *rows, size_t n, struct router **out, struct err *e)
{
    struct router *r = mem_array(1, sizeof *r);
    *out = r;
    if (r) {
        r->rows = rows;
        r->n = n;
        r->row = mem_array(n, sizeof *r->row);
        r->of = mem_array(n, sizeof *r->of);
    }
    enum err_code rc = r && r->row && r->of ? ERR_OK : err_set(e, ERR_MEM, "routes: out of memory");
    for (size_t i = 0; !rc && i < n; i++)
        rc = router_compile(&r->row[i], &rows[i], e);
    if (!rc)
        router_sort(r);
    else
        router_close(out);
    return rc;
}

void router_close(struct router **out)
{
    struct router *r = *out;
    *out = NULL;
    if (!r)
        return;
    mem_free(r->row);
    mem_free(r->of);
    mem_free(r);
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

size_t router_path_params(const struct router *r, const struct route *row,
                          const struct param *const **out)
{
    const struct router_row *x = r->of[router_index(r, row)];
    *out = x->path;
    return x->n_path;
}

size_t router_query_params(const struct router *r, const struct route *row,
                           const struct param *const **out)
{
    const struct router_row *x = r->of[router_index(r, row)];
    *out = x->query;
    return x->n_documented;
}

/* ---- paths ---- */

/* A letter, a digit, or one of /_.,@:- which stand beside them in ASCII. */
static bool router_is_of_path(char c)
{
    return (c >= ',' && c <= ':') || (c >= '@' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '_';
}

/* Bytes no legal path needs, and no legal query: it is logged and repeated in Location. */
static enum err_code router_check(const char *p, size_t n_path, size_t n, struct err *e)
{
    if (!n_path || p[0] != '/')
        return err_set(e, ERR_FORMAT, "the request target must be a path");
    for (size_t i = 0; i < n_path; i++) {
        if (!router_is_of_path(p[i]))
            return err_set(e, ERR_FORMAT, "the path holds a byte that no path of this server has");
        if (p[i] == '/' && i + 1 < n_path && (p[i + 1] == '/' || p[i + 1] == '.'))
            return err_set(e, ERR_FORMAT,
                           "the path holds an empty segment or one that begins with a dot");
    }
    for (size_t i = n_path; i < n; i++)
        if (p[i] <= 0x20 || p[i] >= 0x7f)
            return err_set(e, ERR_FORMAT, "the query holds a byte that must be percent-encoded");
    return ERR_OK;
}

struct router_walk {
    const char *at[ROUTER_PIECES + 1]; /* where each piece began */
    uint8_t failed;                    /* the piece that the last row failed at */
    const char *best;                  /* how far a row came that says something about its form */
    const char *says;
    enum err_code code;
    bool named; /* a row with parameters began like this path: it is no file */
};

static bool router_take_literal(struct text *t, const struct router_piece *x)
{
    if ((size_t)(t->end - t->p) < x->n || memcmp(t->p, x->text, x->n) != 0)
        return false;
    t->p += x->n;
    return true;
}

/* Of what is left out, pieces [from, end). */
static void router_set_standards(const struct router_row *row, uint8_t from, struct target *out)
{
    const uint8_t end = row->piece[from].skip;
    for (uint8_t i = from; i < end; i++)
        if (row->piece[i].param && row->piece[i].param->standard) {
            const char *text = row->piece[i].param->standard;
            struct text t = {text, text + strlen(text)};
            (void)!param_read(row->piece[i].param, &t, out, NULL);
        }
}

/* Does the path match? ERR_NOENT: it does not. ERR_DATA: it does, with impossible numbers. */
static enum err_code router_match(const struct router_row *row, struct text t,
                                  struct router_walk *w, struct target *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    uint8_t i = row->same;
    t.p = i ? w->at[i] : t.p;
    while (i < row->n) {
        const struct router_piece *x = &row->piece[i];
        w->at[i] = t.p;
        if (x->skip) { /* a literal stands behind every bracket */
            struct text ahead = t;
            if (!router_take_literal(&ahead, x + 1)) {
                router_set_standards(row, i, out);
                i = x->skip;
                continue;
            }
        } else if (x->text) {
            if (!router_take_literal(&t, x))
                break;
            w->named |= !i && row->n > 1 && x->n > 1 && t.p[-1] == '/';
        } else if ((rc = param_read(x->param, &t, out, e)) != ERR_OK) {
            break;
        }
        i++;
    }
    w->at[i] = t.p;
    w->failed = i;
    if (rc && rc != ERR_NOENT)
        return rc;
    if (i == row->n && text_at_end(&t))
        return ERR_OK;
    const struct param *param = i < row->n ? row->piece[i].param : NULL;
    const char *says = param && !strcmp(param->name, "rev") ? param->must
                       : row->anchor && i > row->anchor     ? row->form
                                                            : NULL;
    if (says && (!w->best || t.p > w->best)) {
        w->best = t.p;
        w->says = says;
        w->code = row->route->query & QUERY_VIEW ? ERR_FORMAT : ERR_NOENT;
    }
    return ERR_NOENT;
}

static enum err_code router_find(const struct router *r, const char *text, size_t n,
                                 const struct router_row **found, struct target *out, struct err *e)
{
    const struct text t = {text, text + n};
    struct router_walk w = {.failed = 0};
    for (size_t i = 0; i < r->n; i++) {
        const struct router_row *row = &r->row[i];
        if ((i && row->same > w.failed) || (!row->n_beginning && w.named))
            continue;
        enum err_code rc = router_match(row, t, &w, out, e);
        if (!rc)
            *found = row;
        if (rc != ERR_NOENT)
            return rc;
    }
    return w.says ? err_set(e, w.code, "%s", w.says)
                  : err_set(e, ERR_NOENT, "there is nothing at this path");
}

/* ---- queries ---- */

struct router_query {
    const struct router_row *row;
    uint32_t seen; /* a bit a parameter */
};

static bool router_has(const struct router_query *q, const char *name)
{
    for (uint8_t i = 0; i < q->row->n_query; i++)
        if (q->seen >> i & 1 && !strcmp(q->row->query[i]->name, name))
            return true;
    return false;
}

/* Of a signed address (auth.c). */
static bool router_is_signature(struct text *one)
{
    return text_take(one, "exp=") || text_take(one, "key=") || text_take(one, "scope=") ||
           text_take(one, "sig=");
}

static enum err_code router_unknown(const struct router_row *row, struct err *e)
{
    struct buf names = {0};
    for (uint8_t i = 0; i < row->n_query; i++)
        buf_printf(&names, "%s%s", i ? ", " : "", row->query[i]->name);
    buf_u8(&names, 0);
    enum err_code rc = err_set(e, ERR_FORMAT, "the query may hold %s, each once",
                               names.failed ? "some words" : (const char *)names.data);
    buf_free(&names);
    return rc;
}

/* One part of a query. What it holds beside the parameters is for caches and not ours (Cesium adds
 * v=REVISION), but for lists, where a misspelt key would be a longer list. */
static enum err_code router_take(struct router_query *q, struct text one, struct target *out,
                                 struct err *e)
{
    if (router_is_signature(&one))
        return ERR_OK;
    for (uint8_t i = 0; i < q->row->n_query; i++) {
        const struct param *p = q->row->query[i];
        const size_t n = strlen(p->name);
        if ((size_t)(one.end - one.p) <= n || one.p[n] != '=' || memcmp(one.p, p->name, n) != 0)
            continue;
        one.p += n + 1;
        const bool again = q->seen >> i & 1;
        q->seen |= 1u << i;
        enum err_code rc = again ? ERR_NOENT : param_read(p, &one, out, e);
        if (rc == ERR_NOENT || (!rc && !text_at_end(&one)))
            return err_set(e, ERR_FORMAT, "%s is %s, given once", p->name, p->must);
        return rc;
    }
    return q->row->route->query & QUERY_STRICT ? router_unknown(q->row, e) : ERR_OK;
}

/* What parameters say of each other. */
static enum err_code router_agree(const struct router_query *q, struct target *out, struct err *e)
{
    static const char *const camera[] = {"size", "fov", "error", "speed", "horizon"};
    const unsigned groups = q->row->route->query;
    struct target_search *s = &out->search;
    for (size_t i = 0; groups & QUERY_SEED && i < sizeof camera / sizeof *camera; i++)
        if (router_has(q, camera[i]) && !router_has(q, "path"))
            return err_set(e, ERR_FORMAT,
                           "size, fov, error, speed and horizon are those of a camera: path says "
                           "where it is");
    out->has_place = groups & QUERY_PLACE && router_has(q, "lon") && router_has(q, "lat");
    if (groups & QUERY_PLACE && router_has(q, "lon") != router_has(q, "lat"))
        return err_set(e, ERR_FORMAT, "lon and lat are given together");
    if (!(groups & QUERY_SEARCH))
        return ERR_OK;
    s->asked = q->seen != 0;
    if (!router_has(q, "sort"))
        s->sort = s->has_near     ? SEARCH_BY_DISTANCE
                  : s->has_colour ? SEARCH_BY_COLOUR
                                  : SEARCH_BY_NUMBER;
    return (s->sort == SEARCH_BY_DISTANCE && !s->has_near) ||
                   (s->sort == SEARCH_BY_COLOUR && !s->has_colour)
               ? err_set(e, ERR_FORMAT, "sort=distance is from near, sort=colour from colour")
               : ERR_OK;
}

static enum err_code router_read_query(const struct router_row *row, const char *query, size_t n,
                                       struct target *out, struct err *e)
{
    struct router_query q = {row, 0};
    for (uint8_t i = 0; i < row->n_query; i++)
        if (row->query[i]->standard) {
            const char *text = row->query[i]->standard;
            struct text t = {text, text + strlen(text)};
            (void)!param_read(row->query[i], &t, out, NULL);
        }
    enum err_code rc = ERR_OK;
    for (struct text t = {query, query + n}; !rc && !text_at_end(&t);) {
        const char *amp = memchr(t.p, '&', (size_t)(t.end - t.p));
        rc = router_take(&q, (struct text){t.p, amp ? amp : t.end}, out, e);
        t.p = amp ? amp + 1 : t.end;
    }
    return !rc && row->n_query ? router_agree(&q, out, e) : rc;
}

/* ---- both ---- */

enum err_code router_read(const struct router *r, const char *text, size_t n, struct target *out,
                          struct err *e)
{
    const struct router_row *row = NULL;
    memset(out, 0, sizeof *out);
    out->form.preset = QUANT_PRESETS;
    out->form.sh_degree = FORM_UNSAID;
    out->scale = 1;
    const char *mark = n ? memchr(text, '?', n) : NULL;
    const size_t n_path = mark ? (size_t)(mark - text) : n;
    out->path_size = n_path;
    enum err_code rc = router_check(text, n_path, n, e);
    if (!rc)
        rc = router_find(r, text, n_path, &row, out, e);
    if (rc)
        return rc;
    out->route = row->route;
    if (row->keyed && !key_valid(out->key))
        return err_set(e, ERR_NOENT, "tile %u/%u/%u does not exist: z <= 24, x and y < 2^z",
                       out->key.z, out->key.x, out->key.y);
    for (int k = 0; k < 2; k++) {
        uint32_t *side = k ? &out->height_px : &out->width_px;
        *side = (*side < TARGET_SIDE_MAX ? *side : TARGET_SIDE_MAX) * out->scale;
    }
    return router_read_query(row, mark ? mark + 1 : "", mark ? n - n_path - 1 : 0, out, e);
}
