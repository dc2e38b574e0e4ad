/* Hashes of what a run is made of: see inputs.h.
 *
 * Files are hashed by content, not by time: a scene may be copied to another machine.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/photographs/inputs.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "core/base.h"
#include "train/base/config.h"
#include "train/base/run_cell.h"
#include "train/loss/depth_map.h"
#include "train/photographs/depth_prior.h"

enum { INPUTS_CHUNK = 1 << 20 };

static const struct {
    const char *key, *what;
} inputs_parts[INPUTS_PARTS] = {
    [INPUTS_PHOTOGRAPHS] = {"photographs", "photographs, or which of them train, have changed"},
    [INPUTS_MASKS] = {"masks", "masks have changed"},
    [INPUTS_POSES] = {"poses", "poses, exposures or sparse points have changed"},
    [INPUTS_DEPTHS] = {"depths", "known depths have changed"},
};

struct inputs_reader {
    const struct run_cell *job;
    struct hash_state *h[INPUTS_PARTS];
    uint8_t *chunk;
};

static void inputs_add(struct inputs_reader *r, enum inputs_part part, const void *bytes, size_t n)
{
    hash_add(r->h[part], bytes, n);
}

/* Name and bytes of a file. ERR_NOENT: there is none; nothing is added. */
static enum err_code inputs_add_file(struct inputs_reader *r, enum inputs_part part,
                                     const char *name, const char *path, struct err *e)
{
    uint64_t size = 0;
    FILE *f = fopen(path, "rb");
    if (!f)
        return err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s: cannot be read", path);
    inputs_add(r, part, name, strlen(name) + 1);
    for (size_t n; (n = fread(r->chunk, 1, INPUTS_CHUNK, f)) > 0; size += n)
        inputs_add(r, part, r->chunk, n);
    inputs_add(r, part, &size, sizeof size);
    enum err_code rc = ferror(f) ? err_errno(e, ERR_IO, "%s: cannot be read", path) : ERR_OK;
    fclose(f);
    return rc;
}

static void inputs_add_pose(struct inputs_reader *r, const struct scene_image *im)
{
    const struct camera *c = &im->cam;
    const uint32_t size[3] = {c->width_px, c->height_px, im->group};
    const double lens[4] = {c->fx_px, c->fy_px, c->cx_px, c->cy_px};
    inputs_add(r, INPUTS_POSES, size, sizeof size);
    inputs_add(r, INPUTS_POSES, lens, sizeof lens);
    inputs_add(r, INPUTS_POSES, c->rot, sizeof c->rot);
    inputs_add(r, INPUTS_POSES, c->trans, sizeof c->trans);
    inputs_add(r, INPUTS_POSES, im->exposure_ev, sizeof im->exposure_ev);
}

static enum err_code inputs_add_photograph(struct inputs_reader *r, const struct scene_image *im,
                                           struct err *e)
{
    const struct scene *s = r->job->scene;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    enum err_code rc = file_join(dir, s->dir, "images", e);
    if (!rc)
        rc = file_join(path, dir, im->name, e);
    if (!rc)
        rc = inputs_add_file(r, INPUTS_PHOTOGRAPHS, im->name, path, e);
    inputs_add_pose(r, im);
    if (!rc && r->job->cfg->masks)
        rc = file_join(dir, s->dir, "masks", e);
    if (!rc && r->job->cfg->masks)
        rc = mask_path(dir, im->name, path, e);
    if (!rc && r->job->cfg->masks && file_exists(path))
        rc = inputs_add_file(r, INPUTS_MASKS, im->name, path, e);
    return rc;
}

static enum err_code inputs_add_depths(struct inputs_reader *r, const char *dir, struct err *e)
{
    const struct run_cell *job = r->job;
    char path[FILE_PATH_MAX];
    bool found = false;
    enum err_code rc = file_join(path, dir, "points.npy", e);
    if (!rc && file_exists(path))
        rc = inputs_add_file(r, INPUTS_DEPTHS, "points", path, e);
    size_t n_test = job->cfg->final_all ? job->n_test : 0;
    for (size_t i = 0; !rc && i < job->n_images + n_test; i++) {
        uint32_t image = i < job->n_images ? job->images[i] : job->test_images[i - job->n_images];
        const char *name = job->scene->images[image].name;
        rc = depth_map_find(dir, name, &found, path, e);
        if (!rc && found)
            rc = inputs_add_file(r, INPUTS_DEPTHS, name, path, e);
    }
    return rc;
}

static enum err_code inputs_read_all(struct inputs_reader *r, const char *depths, struct err *e)
{
    const struct run_cell *job = r->job;
    char points[FILE_PATH_MAX];
    enum err_code rc = file_join(points, job->scene->dir, "points.bin", e);
    if (!rc)
        rc = inputs_add_file(r, INPUTS_POSES, "points", points, e);
    if (job->cell.cut) /* which parts of photographs train follows from the cell and the points */
        inputs_add(r, INPUTS_PHOTOGRAPHS, "cut", sizeof "cut");
    for (size_t i = 0; !rc && i < job->n_images; i++)
        rc = inputs_add_photograph(r, &job->scene->images[job->images[i]], e);
    for (size_t i = 0; !rc && job->cfg->final_all && i < job->n_test; i++)
        rc = inputs_add_photograph(r, &job->scene->images[job->test_images[i]], e);
    return rc || !depths[0] ? rc : inputs_add_depths(r, depths, e);
}

enum err_code inputs_read(const struct run_cell *job, struct inputs *out, struct err *e)
{
    struct inputs_reader r = {.job = job, .chunk = mem_uninit(INPUTS_CHUNK, 1)};
    char depths[FILE_PATH_MAX];
    bool good = r.chunk;
    *out = (struct inputs){0};
    for (size_t i = 0; i < INPUTS_PARTS; i++)
        good = (r.h[i] = hash_begin()) && good;
    enum err_code rc = good ? depth_prior_dir(job->cfg, job->scene, depths, e)
                            : err_set(e, ERR_MEM, "train: out of memory for hashes");
    if (!rc)
        rc = inputs_read_all(&r, depths, e);
    for (size_t i = 0; i < INPUTS_PARTS; i++)
        hash_text(hash_end(r.h[i]), out->hash[i]);
    if (!job->cfg->masks)
        out->hash[INPUTS_MASKS][0] = '\0';
    if (rc || !depths[0])
        out->hash[INPUTS_DEPTHS][0] = '\0';
    mem_free(r.chunk);
    return rc;
}

json_t *inputs_to_json(const struct inputs *in)
{
    json_t *o = json_object();
    for (size_t i = 0; o && i < INPUTS_PARTS; i++)
        if (json_object_set_new(o, inputs_parts[i].key, json_string(in->hash[i]))) {
            json_decref(o);
            o = NULL;
        }
    return o;
}

enum err_code inputs_check(const struct inputs *in, const char *path, const json_t *meta,
                           struct err *e)
{
    const json_t *saved = json_object_get(meta, "inputs");
    for (size_t i = 0; saved && i < INPUTS_PARTS; i++) {
        const char *was = json_string_value(json_object_get(saved, inputs_parts[i].key));
        if (!was)
            return err_set(e, ERR_FORMAT, "%s: inputs.%s: expected a hash", path,
                           inputs_parts[i].key);
        if (!strcmp(was, in->hash[i]))
            continue;
        if (i == INPUTS_DEPTHS && (!was[0] || !in->hash[i][0]))
            return err_set(e, ERR_DATA, "%s: the run had %sknown depths, now there are %s", path,
                           was[0] ? "" : "no ", in->hash[i][0] ? "some" : "none");
        return err_set(e, ERR_DATA, "%s: %s since the run", path, inputs_parts[i].what);
    }
    return ERR_OK;
}
