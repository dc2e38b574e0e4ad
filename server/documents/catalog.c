/* The datasets at one moment, with their documents. A reload makes a new catalog and swaps a
 * pointer. Requests in progress keep the old one. A replaced revision is served for another day
 * from its open handles, although its file was replaced. A store that cannot be opened changes
 * nothing for the others: what was served of it before stays, and the catalog says what is wrong.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/catalog.h"

#include <dirent.h>
#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "lod/store/range.h"
#include "lod/store/store.h"
#include "server/base/document.h"
#include "server/documents/appearance_api.h"
#include "server/documents/appearance_list.h"
#include "server/documents/appearance_model.h"
#include "server/documents/collection.h"
#include "server/documents/link.h"
#include "server/documents/result_id.h"
#include "server/documents/tileset_links.h"

static struct collection_options catalog_collection(const struct catalog_options *o)
{
    return (struct collection_options){o->public_url, o->city_gaussians};
}

static enum err_code catalog_make_tileset(struct dataset *d, enum tileset_links_of of,
                                          struct body **out, struct err *e)
{
    struct buf text = {0}, b = {0};
    struct tileset_links links;
    enum err_code rc = tileset_links_make(d, of, "", &text, &links, e);
    if (!rc)
        rc = tileset_write(d->index, &links, NULL, NULL, &b, e);
    buf_free(&text);
    return document_take(rc, &b, out, e);
}

static enum err_code catalog_make_document(struct dataset *d, enum dataset_document which,
                                           const struct collection_options *o, struct body **out,
                                           struct err *e)
{
    switch (which) {
    case DATASET_TILESET:
        return catalog_make_tileset(d, TILESET_LINKS_ENTRY, out, e);
    case DATASET_TILESET_MOVING:
        return catalog_make_tileset(d, TILESET_LINKS_MOVING, out, e);
    case DATASET_COLLECTION:
        return collection_describe(d, o, out, e);
    default:
        return appearance_list_all(d, out, e);
    }
}

struct body *catalog_document(struct dataset *d, enum dataset_document which,
                              const struct collection_options *o)
{
    struct body *b = atomic_load(&d->document[which]), *made = NULL;
    if (b || catalog_make_document(d, which, o, &made, NULL))
        return body_ref(b);
    made->modified_s = d->opened_s;
    if (atomic_compare_exchange_strong(&d->document[which], &b, made))
        return body_ref(made);
    body_drop(&made); /* another thread was faster */
    return body_ref(b);
}

/* Those of photographs are made now, whose blobs only this thread may read; of many datasets the
 * others wait until they are asked for: they take as long as opening a small store. */
static enum err_code catalog_make_documents(struct dataset *d, const struct catalog_options *o,
                                            struct err *e)
{
    const struct collection_options collection = catalog_collection(o);
    enum err_code rc = ERR_OK;
    d->opened_s = (int64_t)time(NULL); /* of options and program, too */
    if (d->appearance)
        rc = appearance_model_describe(d, &d->model, e);
    if (!rc && d->appearance)
        rc = appearance_model_photographs(d, &d->photographs, d->taken, e);
    if (!rc && d->appearance)
        rc = appearance_list_open(d, &d->rows, e);
    if (!rc && d->appearance)
        d->model->modified_s = d->photographs->modified_s = d->opened_s;
    for (int i = 0; !rc && i < DATASET_DOCUMENTS && (d->appearance || !o->lazy); i++) {
        struct body *b = catalog_document(d, (enum dataset_document)i, &collection);
        rc = b ? ERR_OK : err_set(e, ERR_MEM, "out of memory for the documents of a dataset");
        body_drop(&b);
    }
    return rc;
}

struct catalog_named {
    struct dataset *ds;
    size_t at; /* in the order in which they were asked for */
};

static int catalog_by_name(const void *pa, const void *pb)
{
    const struct catalog_named *a = pa, *b = pb;
    const int order = strcmp(a->ds->meta.name, b->ds->meta.name);
    return order ? order : (a->at > b->at) - (a->at < b->at);
}

/* By name; those of one name stay in their order. */
static enum err_code catalog_sort(struct dataset **ds, size_t n, struct err *e)
{
    struct catalog_named *by = mem_array(n, sizeof *by);
    if (!by)
        return err_set(e, ERR_MEM, "catalog: out of memory");
    for (size_t i = 0; i < n; i++)
        by[i] = (struct catalog_named){ds[i], i};
    qsort(by, n, sizeof *by, catalog_by_name);
    for (size_t i = 0; i < n; i++)
        ds[i] = by[i].ds;
    mem_free(by);
    return ERR_OK;
}

/* The current dataset of `older` at this path. NULL: there is none. */
static struct dataset *catalog_at(const struct catalog *older, const char *path)
{
    for (size_t i = 0; older && i < older->n_current; i++)
        if (!strcmp(older->ds[i]->path, path))
            return older->ds[i];
    return NULL;
}

static const struct catalog_absent *catalog_absent_at(const struct catalog *older, const char *path)
{
    for (size_t i = 0; older && i < older->n_absent; i++)
        if (!strcmp(older->absent[i].path, path))
            return &older->absent[i];
    return NULL;
}

/* ---- places ---- */

struct catalog_places {
    struct catalog_place *place; /* [n] in the arena, as the paths */
    size_t n, cap, before;       /* before: of earlier arguments */
    struct arena *arena;
};

static enum err_code catalog_add_place(struct catalog_places *l, const char *dir, const char *name,
                                       struct err *e)
{
    const size_t n_dir = dir ? strlen(dir) : 0;
    const char *slash = n_dir && dir[n_dir - 1] != '/' ? "/" : "",
               *path = arena_printf(l->arena, "%s%s%s", dir ? dir : "", slash, name);
    for (size_t i = 0; path && i < l->before; i++)
        if (!strcmp(l->place[i].path, path))
            return ERR_OK;
    if (l->n == l->cap) {
        const size_t cap = l->cap ? 2 * l->cap : 16;
        struct catalog_place *more = arena_get(l->arena, cap, sizeof *more);
        if (more && l->n)
            memcpy(more, l->place, l->n * sizeof *more);
        l->place = more;
        l->cap = cap;
    }
    if (!l->place || !path)
        return err_set(e, ERR_MEM, "catalog: out of memory");
    l->place[l->n++] = (struct catalog_place){.path = path, .far = range_is_url(path)};
    return ERR_OK;
}

static int catalog_is_store_name(const struct dirent *d)
{
    static const char end[] = ".tiles";
    const size_t n = strlen(d->d_name), m = sizeof end - 1;
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)d->d_name[i] < 0x20) /* it would end lines of the log */
            return false;
    return d->d_name[0] != '.' && n > m && !strcmp(d->d_name + n - m, end);
}

/* Is a path below a folder? */
static bool catalog_is_below(const char *path, const char *dir)
{
    size_t n = strlen(dir);
    while (n && dir[n - 1] == '/')
        n--;
    return !strncmp(path, dir, n) && path[n] == '/';
}

/* What older catalogs have of a folder that cannot be read now, and the folder itself. */
static enum err_code catalog_add_lost(struct catalog_places *l, const char *dir, int why,
                                      const struct catalog *older, struct err *e)
{
    const size_t n = l->n;
    enum err_code rc = catalog_add_place(l, NULL, dir, e);
    if (rc || l->n == n) /* it was an argument before */
        return rc;
    struct catalog_place *p = &l->place[l->n - 1];
    p->looked = true;
    errno = why;
    (void)err_errno(&p->why, why == ENOENT ? ERR_NOENT : ERR_IO, "%s: the folder cannot be read",
                    dir);
    for (size_t i = 0; !rc && older && i < older->n_current; i++)
        if (catalog_is_below(older->ds[i]->path, dir))
            rc = catalog_add_place(l, NULL, older->ds[i]->path, e);
    return rc;
}

static enum err_code catalog_add_folder(struct catalog_places *l, const char *dir,
                                        const struct catalog *older, struct err *e)
{
    struct dirent **names = NULL;
    char scene[FILE_PATH_MAX];
    enum err_code rc = file_join(scene, dir, "scene.json", e);
    if (!rc && file_exists(scene))
        rc = err_set(e, ERR_FORMAT,
                     "%s: a folder, and a tile store is a file; `citysplat tile` makes one of a "
                     "trained scene",
                     dir);
    if (rc)
        return rc;
    const int n = scandir(dir, &names, catalog_is_store_name, alphasort);
    if (n < 0)
        return catalog_add_lost(l, dir, errno, older, e);
    for (int i = 0; i < n; i++) {
        if (!rc)
            rc = catalog_add_place(l, dir, names[i]->d_name, e);
        free(names[i]);
    }
    free(names);
    return rc;
}

/* Was it a folder with stores? */
static bool catalog_was_folder(const struct catalog *older, const char *path)
{
    for (size_t i = 0; older && i < older->n_current; i++)
        if (catalog_is_below(older->ds[i]->path, path))
            return true;
    return false;
}

enum err_code catalog_list(const char *const *args, size_t n, const struct catalog *older,
                           struct arena *a, struct catalog_place **out, size_t *n_out,
                           size_t *folders, struct err *e)
{
    struct catalog_places l = {.arena = a};
    enum err_code rc = ERR_OK;
    *folders = 0;
    for (size_t i = 0; i < n && !rc; i++) {
        const bool folder = !range_is_url(args[i]) && file_is_dir(args[i]);
        l.before = l.n;
        *folders += folder;
        rc = folder                               ? catalog_add_folder(&l, args[i], older, e)
             : catalog_was_folder(older, args[i]) ? catalog_add_lost(&l, args[i], ENOENT, older, e)
                                                  : catalog_add_place(&l, NULL, args[i], e);
    }
    *out = l.place;
    *n_out = l.n;
    return rc;
}

enum err_code catalog_list_same(const struct catalog *c, struct arena *a,
                                struct catalog_place **out, size_t *n_out, struct err *e)
{
    struct catalog_places l = {.arena = a};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < c->n_current && !rc; i++)
        rc = catalog_add_place(&l, NULL, c->ds[i]->path, e);
    l.before = l.n; /* one that is served as it was is among both */
    for (size_t i = 0; i < c->n_absent && !rc; i++)
        rc = catalog_add_place(&l, NULL, c->absent[i].path, e);
    *out = l.place;
    *n_out = l.n;
    return rc;
}

/* Is the store at a path still the one of d? */
static enum err_code catalog_is_store(const struct dataset *d, const char *path, bool *same,
                                      struct err *e)
{
    struct store *now = NULL;
    enum err_code rc = store_open(path, &now, e);
    *same = !rc && !strcmp(d->source, store_info(now)->revision);
    store_close(&now);
    return rc;
}

static bool catalog_is_sound(struct dataset *d)
{
    return !atomic_load(&d->n_failed) && !store_replaced(d->index);
}

void catalog_look(struct catalog_place *p, const struct catalog_options *o,
                  const struct catalog *older)
{
    struct dataset *was = catalog_at(older, p->path);
    struct err *e = &p->why;
    bool same = false;
    if (p->looked) /* a folder that cannot be read */
        return;
    p->looked = true;
    enum err_code rc =
        was && catalog_is_sound(was) ? catalog_is_store(was, p->path, &same, e) : ERR_OK;
    if (!rc && same) {
        p->ds = dataset_ref(was);
        return;
    }
    if (!rc)
        rc = dataset_open(p->path, o->readers, o->geoid, &p->ds, e);
    if (!rc && !o->lazy)
        rc = dataset_open_all(p->ds, e);
    if (!rc)
        result_id_tiles_edition(p->ds, o->preset, p->ds->edition);
    if (!rc)
        rc = catalog_make_documents(p->ds, o, e);
    if (!rc)
        store_rest(p->ds->stores[0]);
    else
        dataset_drop(&p->ds);
    p->why.code = rc; /* also where out of memory for a message */
}

void catalog_forget(struct catalog_place *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        dataset_drop(&p[i].ds);
}

/* ---- revisions that were replaced ---- */

/* Is this revision, or (any: NULL) another one of the name, among the first n? */
static bool catalog_has(const struct catalog *c, size_t n, const char *name, const char *revision)
{
    for (size_t i = 0; i < n; i++)
        if (!strcmp(c->ds[i]->meta.name, name) &&
            (!revision || !strcmp(c->ds[i]->meta.revision, revision)))
            return true;
    return false;
}

/* Add an older revision, unless its time is over, or it is there, or as many as may be; they come
 * latest first. */
static void catalog_keep(struct catalog *c, struct dataset *d, double replaced_s, double now_s,
                         const struct catalog_options *o)
{
    const char *name = d->meta.name;
    size_t n_same = 0;
    for (size_t i = c->n_current; i < c->n; i++)
        n_same += !strcmp(c->ds[i]->meta.name, name);
    if (!catalog_has(c, c->n_current, name, NULL) || catalog_has(c, c->n, name, d->meta.revision))
        return;
    if (now_s - replaced_s > o->keep_s || n_same >= o->keep_revisions) {
        log_info("serve", "revision dropped name=%s revision=%s age_s=%.0f", name, d->meta.revision,
                 now_s - replaced_s);
        return;
    }
    c->replaced_s[c->n] = replaced_s;
    c->ds[c->n++] = dataset_ref(d);
}

static void catalog_keep_older(struct catalog *c, const struct catalog *older, double now_s,
                               const struct catalog_options *o)
{
    for (size_t i = 0; i < older->n; i++) /* those that are replaced now come first in it */
        catalog_keep(c, older->ds[i], older->replaced_s[i] > 0 ? older->replaced_s[i] : now_s,
                     now_s, o);
}

static enum err_code catalog_alloc(size_t n, size_t n_absent, struct catalog **out, struct err *e)
{
    struct catalog *c = mem_array(1, sizeof *c);
    *out = c;
    if (c) {
        atomic_init(&c->refs, 1);
        c->ds = mem_array(n, sizeof *c->ds);
        c->replaced_s = mem_array(n, sizeof *c->replaced_s);
        c->absent = mem_array(n_absent, sizeof *c->absent);
    }
    if (c && c->ds && c->replaced_s && c->absent)
        return ERR_OK;
    catalog_drop(out);
    return err_set(e, ERR_MEM, "catalog: out of memory");
}

/* ---- one of old and new ---- */

/* A store is not served as it is now. why NULL: it was not looked at, and is as it was before. */
static enum err_code catalog_miss(struct catalog *c, const char *path, const struct err *why,
                                  const struct catalog_absent *before,
                                  const struct catalog_options *o, struct err *e)
{
    struct catalog_absent *x = &c->absent[c->n_absent];
    if (why) {
        const double pause_s = before && before->pause_s > 0 ? 2 * before->pause_s : o->again_s;
        x->pause_s = fmin(pause_s, 60 * o->again_s);
        x->again_s = clock_s() + x->pause_s;
        x->code = why->code;
        snprintf(x->why, sizeof x->why, "%.*s", (int)sizeof x->why - 1,
                 why->msg[0] ? why->msg : err_text(why->code));
    } else if (before) {
        *x = *before;
    } else {
        x->code = ERR_BUSY;
        snprintf(x->why, sizeof x->why, "it is not opened yet");
    }
    x->path = mem_text(path);
    c->n_absent += x->path != NULL;
    return x->path ? ERR_OK : err_set(e, ERR_MEM, "catalog: out of memory");
}

/* What is served of one place: what was found there, else what the older catalog has. */
static enum err_code catalog_take(struct catalog *c, struct catalog_place *p,
                                  const struct catalog_options *o, const struct catalog *older,
                                  struct err *e)
{
    struct dataset *was = p->ds ? NULL : catalog_at(older, p->path);
    const struct catalog_absent *before = catalog_absent_at(older, p->path);
    const bool failed = p->looked && !p->ds;
    enum err_code rc = ERR_OK;
    if (failed || (!p->looked && (before || !was)))
        rc = catalog_miss(c, p->path, failed ? &p->why : NULL, before, o, e);
    if (p->ds)
        c->ds[c->n++] = p->ds;
    else if (was)
        c->ds[c->n++] = dataset_ref(was);
    p->ds = NULL;
    return rc;
}

/* Which of two stores of one name is served: the one that is, else the first. */
static bool catalog_yields(const struct catalog *older, const struct dataset *d)
{
    const struct dataset *now = older ? catalog_find(older, d->meta.name, "") : NULL;
    return !now || strcmp(now->path, d->path) != 0;
}

static enum err_code catalog_unique(struct catalog *c, const struct catalog_options *o,
                                    const struct catalog *older, struct err *e)
{
    enum err_code rc = ERR_OK;
    size_t n = 0;
    for (size_t i = 0; i < c->n; i++) { /* sorted, and those of one name as they were asked for */
        struct dataset *d = c->ds[i], *last = n ? c->ds[n - 1] : NULL;
        const bool twin = last && !strcmp(last->meta.name, d->meta.name);
        if (twin && catalog_yields(older, last) && !catalog_yields(older, d)) {
            c->ds[n - 1] = d;
            d = last;
        }
        if (!twin) {
            c->ds[n++] = d;
            continue;
        }
        struct err why = {0};
        char shown[2][RANGE_URL_MAX];
        range_show(d->path, shown[0]);
        range_show(c->ds[n - 1]->path, shown[1]);
        (void)err_set(&why, ERR_ARG,
                      "%s: holds a dataset named '%s', as %s does: serve one of them", shown[0],
                      d->meta.name, shown[1]);
        if (!rc)
            rc = catalog_miss(c, d->path, &why, catalog_absent_at(older, d->path), o, e);
        dataset_drop(&d);
    }
    c->n = n;
    return rc;
}

enum err_code catalog_make(struct catalog_place *p, size_t n, const struct catalog_options *o,
                           const struct catalog *older, struct catalog **out, struct err *e)
{
    enum err_code rc = catalog_alloc(n + (older ? older->n : 0), 2 * n, out, e);
    struct catalog *c = *out;
    if (rc)
        return rc;
    for (size_t i = 0; i < n && !rc; i++)
        rc = catalog_take(c, &p[i], o, older, e);
    if (!rc)
        rc = catalog_sort(c->ds, c->n, e);
    if (!rc)
        rc = catalog_unique(c, o, older, e);
    c->n_current = c->n;
    const struct collection_options collection = catalog_collection(o);
    if (!rc)
        rc = collection_list(c->ds, c->n_current, &collection, &c->collections, e);
    if (!rc)
        c->collections->modified_s = (int64_t)time(NULL);
    if (!rc && older)
        catalog_keep_older(c, older, clock_s(), o);
    if (rc)
        catalog_drop(out);
    return rc;
}

/* ---- what changed ---- */

/* Calls f for each dataset that comes (was NULL), goes (now NULL) or is another revision. */
static void catalog_each_change(const struct catalog *older, const struct catalog *newer,
                                void (*f)(void *user, const struct dataset *was,
                                          const struct dataset *now),
                                void *user)
{
    for (size_t i = 0; i < newer->n_current; i++) {
        const struct dataset *now = newer->ds[i],
                             *was = older ? catalog_find(older, now->meta.name, "") : NULL;
        if (!was || strcmp(was->meta.revision, now->meta.revision) != 0)
            f(user, was, now);
    }
    for (size_t i = 0; older && i < older->n_current; i++)
        if (!catalog_find(newer, older->ds[i]->meta.name, ""))
            f(user, older->ds[i], NULL);
}

static void catalog_put_change(void *user, const struct dataset *was, const struct dataset *now)
{
    json_t *o = user;
    if (was && now)
        json_array_append_new(json_object_get(o, "replaced"),
                              json_pack("{s:s,s:s,s:s}", "name", now->meta.name, "from",
                                        was->meta.revision, "to", now->meta.revision));
    else
        json_array_append_new(json_object_get(o, now ? "added" : "removed"),
                              json_string((now ? now : was)->meta.name));
}

json_t *catalog_changes(const struct catalog *older, const struct catalog *newer)
{
    json_t *failed = json_array(),
           *o = json_pack("{s:[],s:[],s:[],s:o}", "added", "removed", "replaced", "failed", failed);
    catalog_each_change(older, newer, catalog_put_change, o);
    for (size_t i = 0; i < newer->n_absent; i++) {
        char shown[RANGE_URL_MAX];
        range_show(newer->absent[i].path, shown);
        json_array_append_new(failed,
                              json_pack("{s:s,s:s}", "store", shown, "why", newer->absent[i].why));
    }
    return o;
}

static void catalog_log_change(void *user, const struct dataset *was, const struct dataset *now)
{
    (void)user;
    if (!now)
        log_info("serve", "dataset removed name=%s revision=%s", was->meta.name,
                 was->meta.revision);
    else if (was)
        log_info("serve", "dataset replaced name=%s revision=%s before=%s tiles=%zu file=%s",
                 now->meta.name, now->meta.revision, was->meta.revision, now->n_tiles,
                 store_path(now->index));
    else
        log_info("serve", "dataset name=%s revision=%s tiles=%zu file=%s", now->meta.name,
                 now->meta.revision, now->n_tiles, store_path(now->index));
}

void catalog_log(const struct catalog *older, const struct catalog *newer)
{
    catalog_each_change(older, newer, catalog_log_change, NULL);
    for (size_t i = 0; i < newer->n_absent; i++) {
        const struct catalog_absent *x = &newer->absent[i],
                                    *was = catalog_absent_at(older, x->path);
        const struct dataset *ds = catalog_at(newer, x->path);
        if (was && !strcmp(was->why, x->why))
            continue;
        char shown[RANGE_URL_MAX];
        range_show(x->path, shown);
        log_warn("serve", "store %s is not served%s%s%s: %s", shown, ds ? " as it is now; " : "",
                 ds ? ds->meta.name : "", ds ? " stays as it was" : "", x->why);
    }
    for (size_t i = 0; older && i < older->n_absent; i++) {
        char shown[RANGE_URL_MAX];
        range_show(older->absent[i].path, shown);
        if (catalog_at(newer, older->absent[i].path) &&
            !catalog_absent_at(newer, older->absent[i].path))
            log_info("serve", "store %s is served again", shown);
    }
}

/* ---- the end ---- */

enum err_code catalog_expire(const struct catalog *c, const struct catalog_options *o, double now_s,
                             struct catalog **out, struct err *e)
{
    bool over = false;
    *out = NULL;
    for (size_t i = c->n_current; i < c->n; i++)
        over |= now_s - c->replaced_s[i] > o->keep_s;
    enum err_code rc = over ? catalog_alloc(c->n, c->n_absent, out, e) : ERR_OK;
    if (rc || !over)
        return rc;
    for (; (*out)->n < c->n_current; (*out)->n++)
        (*out)->ds[(*out)->n] = dataset_ref(c->ds[(*out)->n]);
    (*out)->n_current = c->n_current;
    (*out)->collections = body_ref(c->collections);
    for (size_t i = 0; i < c->n_absent && !rc; i++)
        rc = catalog_miss(*out, c->absent[i].path, NULL, &c->absent[i], o, e);
    for (size_t i = c->n_current; i < c->n && !rc; i++)
        catalog_keep(*out, c->ds[i], c->replaced_s[i], now_s, o);
    if (rc)
        catalog_drop(out);
    return rc;
}

struct catalog *catalog_ref(struct catalog *c)
{
    atomic_fetch_add_explicit(&c->refs, 1, memory_order_relaxed);
    return c;
}

void catalog_drop(struct catalog **out)
{
    struct catalog *c = *out;
    *out = NULL;
    if (!c || atomic_fetch_sub_explicit(&c->refs, 1, memory_order_acq_rel) != 1)
        return;
    for (size_t i = 0; i < c->n; i++)
        dataset_drop(&c->ds[i]);
    mem_free(c->ds);
    mem_free(c->replaced_s);
    for (size_t i = 0; i < c->n_absent; i++)
        mem_free(c->absent[i].path);
    mem_free(c->absent);
    body_drop(&c->collections);
    mem_free(c);
}

struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev)
{
    size_t from = 0, to = c->n_current; /* those before `from` come before the name */
    while (from < to) {
        const size_t mid = (from + to) / 2;
        if (strcmp(c->ds[mid]->meta.name, name) < 0)
            from = mid + 1;
        else
            to = mid;
    }
    if (from < c->n_current && !strcmp(c->ds[from]->meta.name, name) &&
        (!*rev || !strcmp(c->ds[from]->meta.revision, rev)))
        return c->ds[from];
    for (size_t i = c->n_current; i < c->n && *rev; i++)
        if (!strcmp(c->ds[i]->meta.name, name) && !strcmp(c->ds[i]->meta.revision, rev))
            return c->ds[i];
    return NULL;
}
