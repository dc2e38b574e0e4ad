/* Named appearances: see named_appearance.h.
 *
 * Answers read a table in memory. A change makes a new one after it was written. `writing` is held
 * for a whole change, `lock` only to take or replace the table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/named_appearance.h"

#include <pthread.h>
#include <string.h>

#include "server/base/condition.h"
#include "server/data/named_appearance_file.h"

struct named_appearance {
    pthread_mutex_t writing; /* for file */
    struct named_appearance_file *file;
    pthread_mutex_t lock; /* for table */
    struct named_appearance_table *table;
};

/* ---- the table ---- */

struct named_appearance_table *named_appearance_now(struct named_appearance *k)
{
    if (!k)
        return NULL;
    pthread_mutex_lock(&k->lock);
    struct named_appearance_table *t = named_appearance_ref(k->table);
    pthread_mutex_unlock(&k->lock);
    return t;
}

/* Takes over a table. */
static void named_appearance_adopt(struct named_appearance *k, struct named_appearance_table *newer)
{
    pthread_mutex_lock(&k->lock);
    struct named_appearance_table *was = k->table;
    k->table = newer;
    pthread_mutex_unlock(&k->lock);
    named_appearance_drop(&was);
}

/* ---- opening ---- */

enum err_code named_appearance_open(const char *dir, struct named_appearance **out, struct err *e)
{
    struct named_appearance *k = mem_array(1, sizeof *k);
    *out = k;
    if (!k)
        return err_set(e, ERR_MEM, "named appearances: out of memory");
    pthread_mutex_init(&k->writing, NULL);
    pthread_mutex_init(&k->lock, NULL);
    enum err_code rc = named_appearance_file_open(dir, &k->file, &k->table, e);
    if (rc)
        named_appearance_close(out);
    return rc;
}

enum err_code named_appearance_check(const char *dir, struct err *e)
{
    struct named_appearance *k = NULL;
    struct err why = {0};
    enum err_code rc = named_appearance_open(dir, &k, &why);
    named_appearance_close(&k);
    return rc && rc != ERR_BUSY ? err_set(e, rc, "%s", why.msg) : ERR_OK;
}

void named_appearance_close(struct named_appearance **out)
{
    struct named_appearance *k = *out;
    *out = NULL;
    if (!k)
        return;
    named_appearance_file_close(&k->file);
    named_appearance_drop(&k->table);
    pthread_mutex_destroy(&k->writing);
    pthread_mutex_destroy(&k->lock);
    mem_free(k);
}

/* ---- changes; by `writing` ---- */

struct named_appearance_change {
    const char *ds, *name;
    const struct named_appearance_row *row; /* NULL: the name is removed */
    const struct named_appearance_condition *when;
};

/* Returns whether the table is as after the change. */
static bool named_appearance_is_so(const struct named_appearance_table *t,
                                   const struct named_appearance_change *c)
{
    const struct named_appearance_row *was = named_appearance_find(t, c->ds, c->name);
    return c->row ? was && !strcmp(was->text, c->row->text) &&
                        !memcmp(&was->model, &c->row->model, sizeof was->model)
                  : !was;
}

/* ERR_DATA: the request's conditions do not hold for what the name stands for (NULL: nothing). */
static enum err_code named_appearance_holds(const struct named_appearance_condition *when,
                                            const struct named_appearance_row *row, struct err *e)
{
    char etag[BODY_ETAG_SIZE] = "";
    if (row)
        named_appearance_etag(row, etag);
    if (condition_may_write(when->match, when->none_match, row ? etag : NULL))
        return ERR_OK;
    return err_set(e, ERR_DATA,
                   row ? "the name stands for something else by now"
                       : "there is nothing of this name");
}

static enum err_code named_appearance_room(const struct named_appearance_table *t, const char *ds,
                                           struct err *e)
{
    const struct named_appearance_row *first;
    if (t->n < NAMED_APPEARANCE_MAX &&
        named_appearance_of(t, ds, &first) < NAMED_APPEARANCE_DATASET_MAX)
        return ERR_OK;
    return err_set(
        e, ERR_LIMIT,
        "no more names are kept: %d of a dataset, %d of all; delete some that nobody uses",
        NAMED_APPEARANCE_DATASET_MAX, NAMED_APPEARANCE_MAX);
}

/* The table after the change; *newer NULL: it would be the same. */
static enum err_code named_appearance_decide(const struct named_appearance_table *t,
                                             const struct named_appearance_change *c,
                                             struct named_appearance_table **newer, struct err *e)
{
    const struct named_appearance_row *was = named_appearance_find(t, c->ds, c->name);
    *newer = NULL;
    enum err_code rc = named_appearance_holds(c->when, was, e);
    if (!rc && !c->row && !was)
        rc = err_set(e, ERR_NOENT, "no appearance is kept under this name");
    if (!rc && c->row && !was)
        rc = named_appearance_room(t, c->ds, e);
    if (rc || named_appearance_is_so(t, c))
        return rc;
    *newer = named_appearance_table_change(t, c->ds, c->name, c->row);
    return *newer ? ERR_OK : err_set(e, ERR_MEM, "names: out of memory");
}

/* What went wrong with the file is for the log: it names a path, and who asked is a client. */
static enum err_code named_appearance_write(struct named_appearance *k,
                                            const struct named_appearance_change *c, struct err *e)
{
    struct err why = {0};
    const enum err_code rc = c->row ? named_appearance_file_put(k->file, c->row, &why)
                                    : named_appearance_file_remove(k->file, c->ds, c->name, &why);
    if (!rc)
        return ERR_OK;
    log_error("serve", "%s", why.msg);
    return err_set(e, rc, "the change could not be written; the log says why");
}

/* The changes of this server come one after the other. */
static enum err_code named_appearance_change(struct named_appearance *k,
                                             const struct named_appearance_change *c, bool *created,
                                             struct err *e)
{
    struct named_appearance_table *newer = NULL;
    pthread_mutex_lock(&k->writing);
    struct named_appearance_table *t = named_appearance_now(k);
    *created = !named_appearance_find(t, c->ds, c->name);
    enum err_code rc = named_appearance_decide(t, c, &newer, e);
    if (!rc && newer)
        rc = named_appearance_write(k, c, e);
    if (!rc && newer)
        named_appearance_adopt(k, newer);
    else
        named_appearance_drop(&newer);
    named_appearance_drop(&t);
    pthread_mutex_unlock(&k->writing);
    return rc;
}

enum err_code named_appearance_put(struct named_appearance *k,
                                   const struct named_appearance_row *row,
                                   const struct named_appearance_condition *when, bool *created,
                                   struct err *e)
{
    const struct named_appearance_change c = {row->ds, row->name, row, when};
    return named_appearance_change(k, &c, created, e);
}

enum err_code named_appearance_remove(struct named_appearance *k, const char *ds, const char *name,
                                      const struct named_appearance_condition *when, struct err *e)
{
    bool created;
    const struct named_appearance_change c = {ds, name, NULL, when};
    return named_appearance_change(k, &c, &created, e);
}
