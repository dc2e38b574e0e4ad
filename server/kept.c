/* Named appearances: see kept.h.
 *
 * Answers read a table in memory. A change makes a new one after it was written. `writing` is held
 * for a whole change, `lock` only to take or replace the table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/kept.h"

#include <pthread.h>
#include <string.h>

#include "server/condition.h"
#include "server/kept_file.h"

struct kept {
    pthread_mutex_t writing; /* for file */
    struct kept_file *file;
    pthread_mutex_t lock; /* for table */
    struct kept_table *table;
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

/* Takes over a table. */
static void kept_adopt(struct kept *k, struct kept_table *newer)
{
    pthread_mutex_lock(&k->lock);
    struct kept_table *was = k->table;
    k->table = newer;
    pthread_mutex_unlock(&k->lock);
    kept_drop(&was);
}

/* ---- opening ---- */

enum err_code kept_open(const char *dir, struct kept **out, struct err *e)
{
    struct kept *k = mem_array(1, sizeof *k);
    *out = k;
    if (!k)
        return err_set(e, ERR_MEM, "named appearances: out of memory");
    pthread_mutex_init(&k->writing, NULL);
    pthread_mutex_init(&k->lock, NULL);
    enum err_code rc = kept_file_open(dir, &k->file, &k->table, e);
    if (rc)
        kept_close(out);
    return rc;
}

enum err_code kept_check(const char *dir, struct err *e)
{
    struct kept *k = NULL;
    struct err why = {0};
    enum err_code rc = kept_open(dir, &k, &why);
    kept_close(&k);
    return rc && rc != ERR_BUSY ? err_set(e, rc, "%s", why.msg) : ERR_OK;
}

void kept_close(struct kept **out)
{
    struct kept *k = *out;
    *out = NULL;
    if (!k)
        return;
    kept_file_close(&k->file);
    kept_drop(&k->table);
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

/* The changes of this server come one after the other. */
static enum err_code kept_change(struct kept *k, const struct kept_change *c, bool *created,
                                 struct err *e)
{
    struct kept_table *newer = NULL;
    pthread_mutex_lock(&k->writing);
    struct kept_table *t = kept_now(k);
    *created = !kept_find(t, c->ds, c->name);
    enum err_code rc = kept_decide(t, c, &newer, e);
    if (!rc && newer)
        rc = c->row ? kept_file_put(k->file, c->row, e)
                    : kept_file_remove(k->file, c->ds, c->name, e);
    if (!rc && newer)
        kept_adopt(k, newer);
    else
        kept_drop(&newer);
    kept_drop(&t);
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
