/* The whole city in one file, for programs that load no tiles.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer.h"

#include <stdio.h>

#include "lod/export/clip.h"
#include "server/answers/answer_appearance.h"
#include "server/data/encode.h"
#include "server/documents/result_id.h"
#include "server/route/param_clip.h"

struct answer_city_own {
    struct form form; /* complete (encode_form) */
    struct appearance_choice appearance;
    struct target_clip clip; /* n 0: all of it */
};

static enum err_code answer_city_make(struct services *s, const struct job *j, const struct work *w,
                                      struct buf *out, struct err *e)
{
    const struct answer_city_own *o = work_own(w);
    struct store *store = NULL;
    struct clip clip = {0};
    (void)s, (void)j;
    enum err_code rc = o->clip.n ? param_clip_open(&o->clip, &clip, e) : ERR_OK;
    if (!rc)
        rc = work_borrow(w, &store, e);
    if (!rc)
        rc = encode_city(store, o->form, appearance_api_image(&o->appearance),
                         o->clip.n ? &clip : NULL, out, e);
    if (store)
        dataset_return(w->ds, store);
    clip_free(&clip);
    return rc;
}

static size_t answer_city_room(const struct work *w)
{
    const size_t sh = 3 * gauss_sh_count(w->ds->meta.sh_degree);
    return encode_city_count(w->ds->index) * (17 + sh) * sizeof(float);
}

/* As of tiles (answer_tile.c); files of different formats differ. */
static double answer_city_cost(const struct work *w, unsigned *variant)
{
    const double encode_ms = 3e-3;
    *variant = (unsigned)((const struct answer_city_own *)work_own(w))->form.format;
    return 1 + encode_ms * (double)encode_city_count(w->ds->index);
}

static const struct work_kind answer_city_work = {.noun = "city in one file",
                                                  .traits = WORK_ON_DISK | WORK_OF_STORE,
                                                  .size = sizeof(struct answer_city_own),
                                                  .make = answer_city_make,
                                                  .room = answer_city_room,
                                                  .cost = answer_city_cost};

void answer_city(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out)
{
    const struct target_tiles *asked = &target_of_city(t)->tiles;
    const struct form form = encode_form(s->cfg, &d->meta, &asked->form);
    const uint64_t n = encode_city_count(d->index);
    struct appearance_choice choice;
    char text[200];
    if (n > (uint64_t)s->cfg->city_gaussians) {
        snprintf(
            text, sizeof text,
            "the finest level has %llu Gaussians, and files of more than %d are not made here: "
            "take the tiles, or citysplat export",
            (unsigned long long)n, (int)s->cfg->city_gaussians);
        response_problem(out, 422, text);
        return;
    }
    if (!answer_appearance_find_tile(s, d, asked->appearance, &choice, out))
        return;
    if (choice.trained) {
        response_problem(out, 400, "a file has an appearance; \"none\" is of tiles");
        return;
    }
    struct hash128 id = result_id_city(d, form, &choice);
    if (asked->clip.n)
        result_id_clip(&id, &asked->clip);
    out->type = format_type(form.format);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    struct answer_city_own *own =
        response_made(s, r, id, out) ? response_work(d, &answer_city_work, id, out) : NULL;
    if (!own)
        return;
    *own = (struct answer_city_own){form, choice, asked->clip};
    out->work->apart = true;
    out->work->may_lack = asked->clip.n;
}
