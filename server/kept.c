/* Named appearances: see kept.h.
 *
 * Answers read a table in memory. A change makes a new one after it was written. `writing` is held
 * for a whole change, `lock` only to take or replace the table.
 *
 * Shared names are read by one thread: again and again, and soon when a request waits because it
 * names something that is not in the table. A read or a change begins with the table of some
 * `epoch`, and what came is used only if the epoch is still the same. So an answer that was long on
 * its way never replaces a newer table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/kept.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "core/pool.h"
#include "server/condition.h"
#include "server/kept_file.h"
#include "server/kept_shared.h"

enum { KEPT_WAITING_MAX = 512 };
static const double KEPT_READ_S = 2;        /* how long a read may take */
static const double KEPT_FIRST_S = 0.8;     /* the one at the start, and the probe */
static const double KEPT_CHANGE_S = 4;      /* a change, with its repetitions */
static const double KEPT_DISTANCE_S = 0.25; /* between reads that requests ask for */
static const double KEPT_DOWN_S = 1;        /* the same, after one that failed */

struct kept {
    pthread_mutex_t writing; /* for the next three */
    struct kept_file *file;  /* NULL: the names are shared */
    struct kept_shared *changes;
    bool probed;
    struct kept_shared *reads; /* of the thread */
    struct pool_thread *thread;
    double refresh_s;
    pthread_mutex_t lock; /* for what follows */
    pthread_cond_t asked;
    struct kept_table *table;
    uint64_t epoch;
    struct kept_waiter *waiting;
    size_t n_waiting;
    struct kept_stats stats;
    double ended_s,
        read_s; /* clock_s() of the last read, and of the last that succeeded; 0: none */
    bool failing, stop;
};

/* ---- the table ---- */

struct kept_table *kept_now(struct kept *k)
{
    if (!k)
        return NULL;
    pthread_mutex_lock(&k->lock);
    struct kept_table *t = kept_ref(k->table);
    pthread_mutex_unlock(&k->lock);
    return t;
}

static struct kept_table *kept_take(struct kept *k, uint64_t *epoch)
{
    pthread_mutex_lock(&k->lock);
    struct kept_table *t = kept_ref(k->table);
    *epoch = k->epoch;
    pthread_mutex_unlock(&k->lock);
    return t;
}

/* Uses a table that follows from that of `epoch`; it is taken over. False: there is another now. */
static bool kept_adopt(struct kept *k, struct kept_table *newer, uint64_t epoch)
{
    pthread_mutex_lock(&k->lock);
    const bool follows = k->epoch == epoch;
    struct kept_table *was = follows ? k->table : newer;
    if (follows) {
        k->table = newer;
        k->epoch++;
    }
    pthread_mutex_unlock(&k->lock);
    kept_drop(&was);
    return follows;
}

/* ---- reading shared names ---- */

static void kept_note(struct kept *k, enum err_code rc, const struct err *e)
{
    pthread_mutex_lock(&k->lock);
    const bool was = k->failing;
    k->ended_s = clock_s();
    k->read_s = rc ? k->read_s : k->ended_s;
    k->failing = rc;
    k->stats.reads++;
    k->stats.failed += k->failing;
    pthread_mutex_unlock(&k->lock);
    if (rc && !was)
        log_warn("serve", "named appearances cannot be read, and those known so far are used: %s",
                 e->msg);
    else if (!rc && was)
        log_info("serve", "named appearances can be read again");
}

static enum err_code kept_refresh(struct kept *k, struct kept_shared *by, double until_s,
                                  struct err *e)
{
    uint64_t epoch;
    struct err own = {0};
    struct kept_table *have = kept_take(k, &epoch), *newer = NULL;
    e = e ? e : &own;
    enum err_code rc = kept_shared_read(by, have, until_s, &newer, e);
    if (newer && have->n && !newer->etag[0])
        log_warn("serve", "the object of named appearances is gone, and with it %zu names",
                 have->n);
    if (newer)
        (void)kept_adopt(k, newer, epoch);
    kept_drop(&have);
    kept_note(k, rc, e);
    return rc;
}

static void kept_wake(struct kept_waiter *w, bool failed)
{
    while (w) {
        struct kept_waiter *next = w->next; /* it may be gone after the call */
        w->failed = failed;
        w->wake(w);
        w = next;
    }
}

/* When the next read is due; with the lock. */
static double kept_due_s(const struct kept *k)
{
    const double spread = 0.9 + 0.2 * rng_unit((uint64_t)(uintptr_t)k, 0, k->stats.reads);
    return k->ended_s + (k->waiting ? fmin(KEPT_DISTANCE_S, k->refresh_s) : k->refresh_s * spread);
}

static void kept_main(void *user)
{
    struct kept *k = user;
    pthread_mutex_lock(&k->lock);
    while (!k->stop) {
        const double due_s = kept_due_s(k);
        if (clock_s() < due_s) {
            (void)pool_cond_wait(&k->asked, &k->lock, due_s);
            continue;
        }
        struct kept_waiter *w = k->waiting;
        struct err e = {0};
        k->waiting = NULL;
        k->n_waiting = 0;
        pthread_mutex_unlock(&k->lock);
        const enum err_code rc = kept_refresh(k, k->reads, clock_s() + KEPT_READ_S, &e);
        kept_wake(w, rc);
        pthread_mutex_lock(&k->lock);
    }
    struct kept_waiter *w = k->waiting;
    k->waiting = NULL;
    pthread_mutex_unlock(&k->lock);
    kept_wake(w, true);
}

bool kept_is_shared(const struct kept *k)
{
    return k && k->changes;
}

bool kept_await(struct kept *k, struct kept_waiter *w)
{
    pthread_mutex_lock(&k->lock);
    const bool down = k->failing && clock_s() < k->ended_s + KEPT_DOWN_S;
    const bool may = !k->stop && !down && k->n_waiting < KEPT_WAITING_MAX;
    if (may) {
        w->next = k->waiting;
        k->waiting = w;
        k->n_waiting++;
        pthread_cond_signal(&k->asked);
    }
    pthread_mutex_unlock(&k->lock);
    return may;
}

void kept_count(struct kept *k, struct kept_stats *out)
{
    *out = (struct kept_stats){0};
    if (!kept_is_shared(k))
        return;
    pthread_mutex_lock(&k->lock);
    *out = k->stats;
    out->age_s = k->read_s > 0 ? clock_s() - k->read_s : -1;
    pthread_mutex_unlock(&k->lock);
}

/* ---- opening ---- */

static enum err_code kept_alloc(struct kept **out, struct err *e)
{
    struct kept *k = mem_array(1, sizeof *k);
    *out = k;
    if (!k)
        return err_set(e, ERR_MEM, "named appearances: out of memory");
    pthread_mutex_init(&k->writing, NULL);
    pthread_mutex_init(&k->lock, NULL);
    pool_cond_init(&k->asked);
    return ERR_OK;
}

enum err_code kept_open(const char *dir, struct kept **out, struct err *e)
{
    enum err_code rc = kept_alloc(out, e);
    if (!rc)
        rc = kept_file_open(dir, &(*out)->file, &(*out)->table, e);
    if (rc)
        kept_close(out);
    return rc;
}

/* Before the first change: conditions that are ignored would lose changes. */
static enum err_code kept_probe(struct kept *k, double until_s, struct err *e)
{
    if (k->probed)
        return ERR_OK;
    struct kept_table *t = kept_now(k);
    enum err_code rc = kept_shared_probe(k->changes, t, until_s, e);
    kept_drop(&t);
    k->probed = !rc;
    return rc;
}

/* The first read, and the probe. A server that does not answer now is no reason not to start. */
static enum err_code kept_begin(struct kept *k, struct err *e)
{
    struct err why = {0};
    enum err_code rc = kept_refresh(k, k->reads, clock_s() + KEPT_FIRST_S, &why);
    if (rc && rc != ERR_BUSY)
        return err_set(e, rc, "%s", why.msg);
    if (!rc)
        rc = kept_probe(k, clock_s() + KEPT_FIRST_S, &why);
    if (rc == ERR_FORMAT || rc == ERR_MEM)
        return err_set(e, rc, "%s", why.msg);
    if (rc && rc != ERR_BUSY)
        log_warn("serve", "named appearances cannot be changed here: %s", why.msg);
    return ERR_OK;
}

enum err_code kept_open_shared(const char *url, double refresh_s, struct kept **out, struct err *e)
{
    enum err_code rc = kept_alloc(out, e);
    struct kept *k = *out;
    if (!rc)
        rc = kept_shared_open(url, &k->changes, e);
    if (!rc)
        rc = kept_shared_open(url, &k->reads, e);
    if (!rc && !(k->table = kept_table_alloc(0)))
        rc = err_set(e, ERR_MEM, "named appearances: out of memory");
    if (!rc) {
        k->refresh_s = refresh_s;
        rc = kept_begin(k, e);
    }
    if (!rc)
        rc = pool_start(kept_main, k, &k->thread, e);
    if (rc)
        kept_close(out);
    return rc;
}

enum err_code kept_check(const char *dir, const char *url, struct err *e)
{
    struct kept *k = NULL;
    struct err why = {0};
    enum err_code rc = url ? kept_open_shared(url, 1, &k, &why) : kept_open(dir, &k, &why);
    kept_close(&k);
    return rc && rc != ERR_BUSY ? err_set(e, rc, "%s", why.msg) : ERR_OK;
}

void kept_stop(struct kept *k)
{
    if (!k)
        return;
    pthread_mutex_lock(&k->lock);
    k->stop = true;
    pthread_cond_signal(&k->asked);
    pthread_mutex_unlock(&k->lock);
}

void kept_close(struct kept **out)
{
    struct kept *k = *out;
    *out = NULL;
    if (!k)
        return;
    kept_stop(k);
    if (k->thread)
        pool_join(&k->thread);
    kept_file_close(&k->file);
    kept_shared_close(&k->changes);
    kept_shared_close(&k->reads);
    kept_drop(&k->table);
    pthread_cond_destroy(&k->asked);
    pthread_mutex_destroy(&k->writing);
    pthread_mutex_destroy(&k->lock);
    mem_free(k);
}

/* ---- changes; by `writing` ---- */

struct kept_change {
    const char *ds, *name;
    const struct kept_row *row; /* NULL: the name is removed */
    const struct kept_condition *when;
};

/* Returns whether the table is as after the change. */
static bool kept_is_so(const struct kept_table *t, const struct kept_change *c)
{
    const struct kept_row *was = kept_find(t, c->ds, c->name);
    return c->row ? was && !strcmp(was->text, c->row->text) &&
                        !memcmp(&was->model, &c->row->model, sizeof was->model)
                  : !was;
}

/* ERR_DATA: the request's conditions do not hold for what the name stands for (NULL: nothing). */
static enum err_code kept_holds(const struct kept_condition *when, const struct kept_row *row,
                                struct err *e)
{
    char etag[BODY_ETAG_SIZE] = "";
    if (row)
        kept_etag(row, etag);
    if (condition_may_write(when->match, when->none_match, row ? etag : NULL))
        return ERR_OK;
    return err_set(e, ERR_DATA,
                   row ? "the name stands for something else by now"
                       : "there is nothing of this name");
}

static enum err_code kept_room(const struct kept_table *t, const char *ds, struct err *e)
{
    const struct kept_row *first;
    if (t->n < KEPT_MAX && kept_of(t, ds, &first) < KEPT_DATASET_MAX)
        return ERR_OK;
    return err_set(
        e, ERR_LIMIT,
        "no more names are kept: %d of a dataset, %d of all; delete some that nobody uses",
        KEPT_DATASET_MAX, KEPT_MAX);
}

/* The table after the change; *newer NULL: it would be the same. */
static enum err_code kept_decide(const struct kept_table *t, const struct kept_change *c,
                                 struct kept_table **newer, struct err *e)
{
    const struct kept_row *was = kept_find(t, c->ds, c->name);
    *newer = NULL;
    enum err_code rc = kept_holds(c->when, was, e);
    if (!rc && !c->row && !was)
        rc = err_set(e, ERR_NOENT, "no appearance is kept under this name");
    if (!rc && c->row && !was)
        rc = kept_room(t, c->ds, e);
    if (rc || kept_is_so(t, c))
        return rc;
    *newer = kept_table_change(t, c->ds, c->name, c->row);
    return *newer ? ERR_OK : err_set(e, ERR_MEM, "names: out of memory");
}

static enum err_code kept_change_file(struct kept *k, const struct kept_change *c, bool *created,
                                      struct err *e)
{
    uint64_t epoch;
    struct kept_table *t = kept_take(k, &epoch), *newer = NULL;
    *created = !kept_find(t, c->ds, c->name);
    enum err_code rc = kept_decide(t, c, &newer, e);
    if (!rc && newer)
        rc = c->row ? kept_file_put(k->file, c->row, e)
                    : kept_file_remove(k->file, c->ds, c->name, e);
    if (!rc && newer)
        (void)kept_adopt(k, newer, epoch);
    else
        kept_drop(&newer);
    kept_drop(&t);
    return rc;
}

/* One attempt: read, decide, write in place of what was read. *sent: an earlier one may have been
 * written, although no answer came. */
static enum err_code kept_try(struct kept *k, const struct kept_change *c, bool *sent,
                              bool *created, double until_s, struct err *e)
{
    uint64_t epoch;
    struct kept_table *newer = NULL;
    enum err_code rc = kept_refresh(k, k->changes, until_s, e);
    if (!rc)
        rc = kept_probe(k, until_s, e);
    if (rc)
        return rc;
    struct kept_table *t = kept_take(k, &epoch);
    if (!*sent) {
        *created = !kept_find(t, c->ds, c->name);
        rc = kept_decide(t, c, &newer, e);
    } else if (!kept_is_so(t, c)) {
        rc = kept_decide(t, c, &newer, e);
    }
    if (!rc && newer) {
        rc = kept_shared_write(k->changes, t->etag, newer, until_s, e);
        *sent |= rc == ERR_BUSY;
        if (rc == ERR_DATA) /* another was quicker */
            rc = e->code = ERR_BUSY;
        if (rc)
            kept_drop(&newer);
        else if (!kept_adopt(k, newer, epoch))
            (void)!kept_refresh(k, k->changes, until_s, NULL);
    }
    kept_drop(&t);
    return rc;
}

static enum err_code kept_change_shared(struct kept *k, const struct kept_change *c, bool *created,
                                        double until_s, struct err *e)
{
    bool sent = false;
    for (unsigned tries = 0;; tries++) {
        const enum err_code rc = kept_try(k, c, &sent, created, until_s, e);
        double wait_s = fmin(1, ldexp(0.05, (int)(tries & 7)));
        wait_s *= 0.5 + 0.5 * rng_unit((uint64_t)(until_s * 1e6), (uint64_t)(uintptr_t)c, tries);
        if (rc != ERR_BUSY)
            return rc;
        if (clock_s() + wait_s >= until_s || signals_stopping())
            return err_add(e, "%u attempts did not succeed, the last", tries + 1);
        nanosleep(&(struct timespec){.tv_nsec = (long)(fmin(wait_s, 0.999) * 1e9)}, NULL);
    }
}

static enum err_code kept_change(struct kept *k, const struct kept_change *c, bool *created,
                                 struct err *e)
{
    struct err own = {0};
    const double until_s = clock_s() + KEPT_CHANGE_S;
    e = e ? e : &own;
    pthread_mutex_lock(&k->writing); /* the changes of this server come one after the other */
    enum err_code rc = k->file               ? kept_change_file(k, c, created, e)
                       : clock_s() < until_s ? kept_change_shared(k, c, created, until_s, e)
                                             : err_set(e, ERR_BUSY, "changes before it take long");
    pthread_mutex_unlock(&k->writing);
    return rc;
}

enum err_code kept_put(struct kept *k, const struct kept_row *row,
                       const struct kept_condition *when, bool *created, struct err *e)
{
    const struct kept_change c = {row->ds, row->name, row, when};
    return kept_change(k, &c, created, e);
}

enum err_code kept_remove(struct kept *k, const char *ds, const char *name,
                          const struct kept_condition *when, struct err *e)
{
    bool created;
    const struct kept_change c = {ds, name, NULL, when};
    return kept_change(k, &c, &created, e);
}
