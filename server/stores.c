/* See stores.h.
 *
 * A change has two steps. First places are looked at (catalog_look), which may take long; then a
 * catalog is made of what was found and of the present one, under `lock`. So a thread that waits
 * for an address holds up nobody, and no change of another is lost.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/stores.h"

#include <math.h>
#include <string.h>

#include "core/pool.h"
#include "lod/store/range.h"
#include "lod/store/remote.h"
#include "server/answers/services.h"

static const double STORES_FAR_S = 5;     /* for addresses, where somebody waits for them */
static const double STORES_PUBLISH_S = 1; /* what was opened meanwhile is served */

struct stores {
    const struct server_config *cfg;
    const char *const *args;
    size_t n_args, folders;
    struct services *s;       /* NULL until stores_give */
    struct catalog *first;    /* until stores_give */
    pthread_mutex_t reload;   /* held by whoever looks at files */
    pthread_rwlock_t looking; /* of options.lazy: read while places are looked at */
    struct catalog_options options;
    struct geoid *geoid;     /* --geoid; NULL: none */
    struct pool_thread *far; /* NULL: no address is asked for */
    pthread_mutex_t lock;    /* of the catalog's making, and of what follows */
    pthread_cond_t changed;
    bool stopping, asked;  /* asked: the thread looks at all addresses */
    uint64_t begun, ended; /* its rounds */
};

/* ---- looking ---- */

struct stores_list {
    struct arena arena;
    struct catalog_place *place;
    size_t n;
};

struct stores_look {
    struct stores *st;
    const struct catalog *older;
    struct catalog_place *place;
    bool all; /* else those alone whose pause is over */
    double now_s;
};

static bool stores_is_due(const struct catalog *c, const char *path, double now_s)
{
    for (size_t i = 0; c && i < c->n_absent; i++)
        if (!strcmp(c->absent[i].path, path))
            return now_s >= c->absent[i].again_s;
    return false;
}

static enum err_code stores_look_at(void *user, size_t i, struct err *e)
{
    const struct stores_look *l = user;
    struct catalog_place *p = &l->place[i];
    (void)e;
    if (!p->far && (l->all || stores_is_due(l->older, p->path, l->now_s)))
        catalog_look(p, &l->st->options, l->older);
    return ERR_OK;
}

/* Files that are due. */
static enum err_code stores_look_near(struct stores *st, const struct catalog *older, bool all,
                                      const struct stores_list *list, struct err *e)
{
    struct stores_look l = {st, older, list->place, all, clock_s()};
    pthread_rwlock_rdlock(&st->looking);
    enum err_code rc = pool_for(list->n, 0, stores_look_at, &l, e);
    pthread_rwlock_unlock(&st->looking);
    return rc;
}

static void stores_look_far(struct stores *st, const struct catalog *older, struct catalog_place *p)
{
    pthread_rwlock_rdlock(&st->looking);
    catalog_look(p, &st->options, older);
    pthread_rwlock_unlock(&st->looking);
}

/* What is asked for, with folders as they are now. */
static enum err_code stores_list(struct stores *st, const struct catalog *older,
                                 struct stores_list *out, struct err *e)
{
    enum { FEW = 64 };
    size_t folders;
    *out = (struct stores_list){0};
    enum err_code rc =
        catalog_list(st->args, st->n_args, older, &out->arena, &out->place, &out->n, &folders, e);
    if (!older)
        st->folders = folders;
    if (st->options.lazy != (out->n > FEW)) { /* who looks at an address is waited for then alone */
        pthread_rwlock_wrlock(&st->looking);
        st->options.lazy = !st->options.lazy;
        pthread_rwlock_unlock(&st->looking);
    }
    return rc;
}

static void stores_list_free(struct stores_list *l)
{
    catalog_forget(l->place, l->n);
    arena_free(&l->arena);
}

/* ---- serving what was found ---- */

/* What was looked at in `list`, among all places of the present catalog. */
static enum err_code stores_merge(struct stores_list *list, const struct catalog *now,
                                  struct stores_list *out, struct err *e)
{
    *out = (struct stores_list){0};
    enum err_code rc = catalog_list_same(now, &out->arena, &out->place, &out->n, e);
    for (size_t i = 0; i < list->n && !rc; i++) {
        struct catalog_place *p = &list->place[i];
        for (size_t k = 0; k < out->n && p->looked; k++)
            if (!strcmp(out->place[k].path, p->path)) {
                out->place[k] = *p;
                p->ds = NULL;
                p->looked = false;
            }
    }
    return rc;
}

/* Makes a catalog of what was found and of the present one, and logs what changed. whole: the list
 * has all places; else those that it was not looked for stay. */
static enum err_code stores_publish(struct stores *st, struct stores_list *list, bool whole,
                                    struct err *e)
{
    struct catalog *newer = NULL;
    struct stores_list merged = {0}, *all = whole ? list : &merged;
    pthread_mutex_lock(&st->lock);
    struct catalog *older = services_catalog(st->s);
    enum err_code rc = whole ? ERR_OK : stores_merge(list, older, &merged, e);
    if (!rc)
        rc = catalog_make(all->place, all->n, &st->options, older, &newer, e);
    if (!rc) {
        catalog_log(older, newer);
        services_set_catalog(st->s, newer, NULL);
        job_forgive(st->s->jobs);
    }
    pthread_mutex_unlock(&st->lock);
    stores_list_free(&merged);
    catalog_drop(&older);
    return rc;
}

/* ---- addresses ---- */

/* Under the lock: is there something to look at? */
static bool stores_far_due(struct stores *st, double now_s, double *next_s)
{
    struct catalog *c = services_catalog(st->s);
    bool due = st->asked;
    for (size_t i = 0; i < c->n_absent; i++)
        if (range_is_url(c->absent[i].path)) {
            due |= now_s >= c->absent[i].again_s;
            *next_s = fmin(*next_s, c->absent[i].again_s);
        }
    catalog_drop(&c);
    return due;
}

/* One round over all addresses that are due. */
static void stores_far_round(struct stores *st, bool all)
{
    struct err e = {0};
    struct stores_list list = {0};
    struct catalog *older = services_catalog(st->s);
    double published_s = clock_s();
    enum err_code rc = catalog_list_same(older, &list.arena, &list.place, &list.n, &e);
    for (size_t i = 0; !rc && i < list.n; i++) {
        struct catalog_place *p = &list.place[i];
        if (!p->far || !(all || stores_is_due(older, p->path, clock_s())))
            continue;
        stores_look_far(st, older, p);
        pthread_mutex_lock(&st->lock);
        const bool stopping = st->stopping;
        pthread_mutex_unlock(&st->lock);
        if (stopping)
            break;
        if (clock_s() - published_s < STORES_PUBLISH_S)
            continue;
        rc = stores_publish(st, &list, false, &e);
        published_s = clock_s();
    }
    if (!rc)
        rc = stores_publish(st, &list, false, &e);
    if (rc)
        log_error("serve", "stores at addresses: %s", e.msg);
    stores_list_free(&list);
    catalog_drop(&older);
}

static void stores_far_main(void *user)
{
    struct stores *st = user;
    pool_alone();
    pthread_mutex_lock(&st->lock);
    while (!st->stopping) {
        const double now_s = clock_s();
        double next_s = now_s + 60;
        if (!stores_far_due(st, now_s, &next_s)) {
            (void)pool_cond_wait(&st->changed, &st->lock, next_s);
            continue;
        }
        const bool all = st->asked;
        st->asked = false;
        st->begun++;
        pthread_mutex_unlock(&st->lock);
        stores_far_round(st, all);
        pthread_mutex_lock(&st->lock);
        st->ended = st->begun;
        pthread_cond_broadcast(&st->changed);
        if (!st->stopping) /* also where nothing could be noted, for want of memory */
            (void)pool_cond_wait(&st->changed, &st->lock, clock_s() + 0.1);
    }
    pthread_mutex_unlock(&st->lock);
}

/* Has all addresses looked at, and waits for that a while. */
static void stores_far_wait(struct stores *st)
{
    const double end_s = clock_s() + STORES_FAR_S;
    if (!st->far)
        return;
    pthread_mutex_lock(&st->lock);
    st->asked = true;
    const uint64_t round = st->begun + 1;
    pthread_cond_broadcast(&st->changed);
    while (st->ended < round && !st->stopping && !signals_stopping() && clock_s() < end_s)
        (void)pool_cond_wait(&st->changed, &st->lock, fmin(end_s, clock_s() + 0.1));
    pthread_mutex_unlock(&st->lock);
}

/* ---- life ---- */

static void stores_set_options(struct stores *st, size_t readers)
{
    const struct server_config *cfg = st->cfg;
    st->options = (struct catalog_options){.readers = readers,
                                           .public_url = cfg->public_url,
                                           .keep_s = cfg->keep_s,
                                           .keep_revisions = (size_t)cfg->keep_revisions,
                                           .city_gaussians = (size_t)cfg->city_gaussians,
                                           .geoid = st->geoid,
                                           .preset = (unsigned)cfg->preset,
                                           .again_s = cfg->again_s};
}

/* Addresses, where there is nothing else to serve, or all shall be looked at. */
static void stores_look_first(struct stores *st, bool all, const struct stores_list *list)
{
    size_t n_open = 0;
    for (size_t i = 0; i < list->n; i++)
        n_open += list->place[i].ds != NULL;
    const double end_s = clock_s() + STORES_FAR_S;
    if (!all && n_open)
        return;
    if (!all)
        remote_until(end_s);
    for (size_t i = 0; i < list->n && (all || clock_s() < end_s); i++)
        if (list->place[i].far)
            stores_look_far(st, NULL, &list->place[i]);
    remote_until(0);
}

/* Files alone, and none of them: whoever asked for them made a mistake. A folder may be empty yet,
 * and an address may be away. */
static enum err_code stores_judge(const struct stores *st, const struct stores_list *list,
                                  struct err *e)
{
    const struct catalog *c = st->first;
    bool far = false;
    for (size_t i = 0; i < list->n; i++)
        far |= list->place[i].far && list->place[i].why.code != ERR_ARG;
    if (c->n_current || st->folders || far || !c->n_absent)
        return ERR_OK;
    return err_set(e, c->absent[0].code, "%s", c->absent[0].why);
}

enum err_code stores_open(const struct server_config *cfg, const char *const *args, size_t n,
                          size_t readers, bool all, struct stores **out, struct err *e)
{
    struct stores *st = mem_array(1, sizeof *st);
    struct stores_list list = {0};
    *out = st;
    if (!st)
        return err_set(e, ERR_MEM, "serve: out of memory");
    st->cfg = cfg;
    st->args = args;
    st->n_args = n;
    pthread_mutex_init(&st->reload, NULL);
    pthread_rwlock_init(&st->looking, NULL);
    pthread_mutex_init(&st->lock, NULL);
    pool_cond_init(&st->changed);
    enum err_code rc = cfg->geoid ? geoid_open(cfg->geoid, &st->geoid, e) : ERR_OK;
    stores_set_options(st, readers);
    if (!rc)
        rc = stores_list(st, NULL, &list, e);
    if (!rc)
        rc = stores_look_near(st, NULL, true, &list, e);
    if (!rc)
        stores_look_first(st, all, &list);
    if (!rc)
        rc = catalog_make(list.place, list.n, &st->options, NULL, &st->first, e);
    if (!rc)
        rc = stores_judge(st, &list, e);
    stores_list_free(&list);
    if (rc)
        stores_close(out);
    return rc;
}

const struct catalog *stores_first(const struct stores *st)
{
    return st->first;
}

void stores_give(struct stores *st, struct services *s)
{
    st->s = s;
    s->geoid = st->geoid;
    services_set_catalog(s, st->first, NULL);
    st->first = NULL;
}

enum err_code stores_start(struct stores *st, struct err *e)
{
    struct catalog *c = services_catalog(st->s);
    bool far = false;
    catalog_log(NULL, c);
    if (!c->n_current && !c->n_absent && st->n_args)
        log_warn("serve",
                 "no store is served yet: copy NAME.tiles into %s and reload (SIGHUP, or POST "
                 "/-/reload on the listener of --admin)",
                 st->args[0]);
    catalog_drop(&c);
    for (size_t i = 0; i < st->n_args; i++)
        far |= range_is_url(st->args[i]);
    return far ? pool_start(stores_far_main, st, &st->far, e) : ERR_OK;
}

void stores_close(struct stores **out)
{
    struct stores *st = *out;
    *out = NULL;
    if (!st)
        return;
    pthread_mutex_lock(&st->lock);
    st->stopping = true;
    pthread_cond_broadcast(&st->changed);
    pthread_mutex_unlock(&st->lock);
    if (st->far)
        pool_join(&st->far);
    catalog_drop(&st->first);
    geoid_close(&st->geoid);
    pthread_cond_destroy(&st->changed);
    pthread_mutex_destroy(&st->lock);
    pthread_rwlock_destroy(&st->looking);
    pthread_mutex_destroy(&st->reload);
    mem_free(st);
}

/* ---- changes ---- */

/* What is wrong with the stores, for whoever asked for a reload. */
static enum err_code stores_fault(const struct catalog *c, struct err *e)
{
    if (!c->n_absent)
        return ERR_OK;
    const struct catalog_absent *x = &c->absent[0];
    return c->n_absent == 1 ? err_set(e, x->code, "%s", x->why)
                            : err_set(e, x->code, "%zu stores are not served as they are now; %s",
                                      c->n_absent, x->why);
}

enum err_code stores_reload(struct stores *st, bool *tried, struct err *e)
{
    struct stores_list list = {0};
    struct catalog *older = services_catalog(st->s);
    pthread_mutex_lock(&st->reload);
    enum err_code rc = stores_list(st, older, &list, e);
    if (!rc)
        rc = stores_look_near(st, older, true, &list, e);
    if (!rc)
        rc = stores_publish(st, &list, true, e);
    pthread_mutex_unlock(&st->reload);
    stores_list_free(&list);
    catalog_drop(&older);
    *tried = !rc;
    if (rc)
        return rc;
    stores_far_wait(st);
    struct catalog *newer = services_catalog(st->s);
    rc = stores_fault(newer, e);
    catalog_drop(&newer);
    return rc;
}

/* Has a folder that could not be read come back? */
static bool stores_has_folder(const struct stores *st, const struct catalog *c, double now_s)
{
    for (size_t i = 0; i < st->n_args; i++)
        if (stores_is_due(c, st->args[i], now_s) && file_is_dir(st->args[i]))
            return true;
    return false;
}

/* Files whose pause is over. */
static void stores_try_again(struct stores *st, const struct catalog *older, double now_s)
{
    struct err e = {0};
    struct stores_list list = {0};
    if (pthread_mutex_trylock(&st->reload)) /* a reload is under way, which looks at all of them */
        return;
    const bool whole = stores_has_folder(st, older, now_s);
    enum err_code rc = whole ? stores_list(st, older, &list, &e)
                             : catalog_list_same(older, &list.arena, &list.place, &list.n, &e);
    if (!rc)
        rc = stores_look_near(st, older, whole, &list, &e);
    if (!rc)
        rc = stores_publish(st, &list, whole, &e);
    pthread_mutex_unlock(&st->reload);
    if (rc)
        log_error("serve", "stores that failed are not tried again now: %s", e.msg);
    stores_list_free(&list);
}

void stores_tick(struct stores *st, double now_s)
{
    struct catalog *fewer = NULL;
    pthread_mutex_lock(&st->lock);
    struct catalog *now = services_catalog(st->s);
    if (!catalog_expire(now, &st->options, now_s, &fewer, NULL) && fewer)
        services_set_catalog(st->s, fewer, NULL);
    pthread_mutex_unlock(&st->lock);
    bool due = false;
    for (size_t i = 0; i < now->n_absent; i++)
        due |= !range_is_url(now->absent[i].path) && now_s >= now->absent[i].again_s;
    if (due)
        stores_try_again(st, now, now_s);
    catalog_drop(&now);
}
