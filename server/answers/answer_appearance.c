/* Appearances: the list, one of them, a posted mix, and network and photographs for clients that
 * compute colours. Also finds the appearance that a request names.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer_appearance.h"

#include <stdio.h>

#include "lod/store/photograph.h"
#include "server/answers/answer.h"
#include "server/documents/appearance_list.h"
#include "server/documents/appearance_model.h"
#include "server/documents/result_id.h"

static void answer_appearance_problem(const struct dataset *d, enum err_code rc,
                                      const struct err *e, struct response *out)
{
    int status = rc == ERR_NOENT ? 404 : rc == ERR_MEM ? 503 : 400;
    response_problem(out, status,
                     d->appearance ? e->msg
                                   : "this dataset was trained without appearance: it has one "
                                     "appearance, leave `appearance` out");
}

bool answer_appearance_find_tile(struct services *s, const struct dataset *d, const char *text,
                                 struct appearance_choice *out, struct response *res)
{
    struct err e = {0};
    char is[TARGET_APPEARANCE_MAX], name[TARGET_KEPT_MAX];
    struct named_appearance_table *kept = *text ? named_appearance_now(s->named_appearances) : NULL;
    is[0] = '\0';
    enum err_code rc = ERR_OK;
    if (*text) { /* most tiles have none */
        snprintf(is, sizeof is, "%s", text);
        rc = appearance_api_resolve(d, kept, is, name, &e);
    }
    if (!rc)
        rc = appearance_api_find(d, is, out, &e);
    if (rc)
        answer_appearance_problem(d, rc, &e, res);
    named_appearance_drop(&kept);
    return !rc;
}

bool answer_appearance_find(struct services *s, const struct dataset *d, const char *text,
                            struct appearance_choice *out, struct response *res)
{
    if (!answer_appearance_find_tile(s, d, text, out, res))
        return false;
    if (out->trained)
        response_problem(res, 400, "a picture has an appearance; \"none\" is of tiles");
    return !out->trained;
}

bool answer_appearance_resolve(struct services *s, const struct dataset *d, struct target *t,
                               struct response *out)
{
    struct err e = {0};
    struct target_tiles *tiles = target_group(t, TARGET_tiles);
    struct target_appearance *other = target_group(t, TARGET_appearance);
    char *appearance = tiles ? tiles->appearance : other ? other->appearance : NULL;
    if (!appearance || !appearance[0] || !s->named_appearances)
        return true;
    struct named_appearance_table *kept = named_appearance_now(s->named_appearances);
    enum err_code rc = appearance_api_resolve(d, kept, appearance, t->names.kept, &e);
    named_appearance_drop(&kept);
    if (rc)
        response_problem(out, 404, e.msg);
    return !rc;
}

static void answer_appearance_describe(const struct request *r, struct dataset *d, const char *text,
                                       struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    enum err_code rc = appearance_api_describe(d, text, &b, &e);
    if (!rc)
        response_document(r, RESPONSE_JSON, b, out);
    else
        answer_appearance_problem(d, rc, &e, out);
}

void answer_appearance_one(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    (void)s;
    answer_appearance_describe(r, d, target_of_appearance(t)->appearance.appearance, out);
}

void answer_appearance_mix(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    (void)t;
    struct err e = {0};
    char text[TARGET_APPEARANCE_MAX], name[TARGET_KEPT_MAX];
    struct named_appearance_table *kept = named_appearance_now(s->named_appearances);
    enum err_code rc = appearance_api_read_mix(d, r->body, r->body_size, text, &e);
    if (!rc)
        rc = appearance_api_resolve(d, kept, text, name, &e);
    named_appearance_drop(&kept);
    if (!rc)
        answer_appearance_describe(r, d, text, out);
    else
        response_refused(out, rc, e.msg);
}

/* A document of a revision; b NULL: the dataset has no appearance. */
static void answer_appearance_document(const struct request *r, struct dataset *d, struct body *b,
                                       struct response *out)
{
    if (!b) {
        response_problem(out, 404, "this dataset was trained without appearance");
        return;
    }
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    response_document(r, RESPONSE_JSON, body_ref(b), out);
}

void answer_appearance_model(struct services *s, const struct request *r, struct dataset *d,
                             const struct target *t, struct response *out)
{
    (void)s, (void)t;
    answer_appearance_document(r, d, d->model, out);
}

void answer_appearance_photographs(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    (void)s, (void)t;
    answer_appearance_document(r, d, d->photographs, out);
}

/* ---- thumbnails ---- */

struct answer_appearance_thumbnail_own {
    uint32_t row;
};

static enum err_code answer_appearance_make_thumbnail(struct services *s, const struct job *j,
                                                      const struct work *w, struct buf *out,
                                                      struct err *e)
{
    const struct answer_appearance_thumbnail_own *o = work_own(w);
    struct store *store;
    (void)s, (void)j;
    enum err_code rc = work_borrow(w, &store, e);
    if (rc)
        return rc;
    rc = photograph_thumbnail(store, appearance_model_photograph(w->ds, o->row), out, e);
    dataset_return(w->ds, store);
    return rc == ERR_NOENT ? err_set(e, ERR_NOENT, "this photograph has no thumbnail") : rc;
}

static size_t answer_appearance_thumbnail_room(const struct work *w)
{
    (void)w;
    return PHOTOGRAPH_BYTES_MAX;
}

static void answer_appearance_tell_thumbnail(const struct work *w, char *out, size_t room)
{
    const struct answer_appearance_thumbnail_own *o = work_own(w);
    snprintf(out, room, "thumbnail %u", (unsigned)o->row);
}

static const struct work_kind answer_appearance_thumbnail_work = {
    .noun = "thumbnail",
    .size = sizeof(struct answer_appearance_thumbnail_own),
    .make = answer_appearance_make_thumbnail,
    .room = answer_appearance_thumbnail_room,
    .tell = answer_appearance_tell_thumbnail};

void answer_appearance_thumbnail(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, struct response *out)
{
    const uint32_t row = target_of_thumbnail(t)->row.row;
    const char *name = appearance_model_photograph(d, row);
    if (!name) {
        response_problem(out, 404, "no photograph has this number");
        return;
    }
    struct hash128 id = result_id_thumbnail(d, name);
    out->type = format_type(FORMAT_JPG);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    if (!response_made(s, r, id, out))
        return;
    struct answer_appearance_thumbnail_own *own =
        response_work(d, &answer_appearance_thumbnail_work, id, out);
    if (own) {
        own->row = row;
        out->work->may_lack = true;
    }
}

/* ---- lists ---- */

struct answer_appearance_list_own {
    struct named_appearance_table *kept; /* a reference */
};

static enum err_code answer_appearance_make_list(struct services *s, const struct job *j,
                                                 const struct work *w, struct buf *out,
                                                 struct err *e)
{
    const struct answer_appearance_list_own *o = work_own(w);
    (void)s, (void)j;
    return appearance_list_write(w->ds, o->kept, out, e);
}

static size_t answer_appearance_list_room(const struct work *w)
{
    const struct answer_appearance_list_own *o = work_own(w);
    return appearance_list_room(w->ds, o->kept);
}

static void answer_appearance_free_list(void *own)
{
    named_appearance_drop(&((struct answer_appearance_list_own *)own)->kept);
}

static const struct work_kind answer_appearance_list_work = {
    .noun = "list of appearances",
    .traits = WORK_COMPRESSED,
    .size = sizeof(struct answer_appearance_list_own),
    .make = answer_appearance_make_list,
    .room = answer_appearance_list_room,
    .free = answer_appearance_free_list};

/* The list is made when a dataset is opened, and again when names are kept or forgotten. */
void answer_appearance_list(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    const struct named_appearance_row *row = NULL;
    struct named_appearance_table *kept = named_appearance_now(s->named_appearances);
    const size_t n_kept = d->appearance ? named_appearance_of(kept, d->meta.name, &row) : 0;
    (void)t;
    out->type = RESPONSE_JSON;
    if (!n_kept) {
        response_body(r, services_document(s, d, DATASET_APPEARANCES), out);
    } else {
        struct hash128 id = result_id_appearances(d, named_appearance_hash(kept, d->meta.name));
        struct answer_appearance_list_own *own =
            response_made(s, r, id, out) ? response_work(d, &answer_appearance_list_work, id, out)
                                         : NULL;
        if (own)
            own->kept = named_appearance_ref(kept);
    }
    named_appearance_drop(&kept);
}
