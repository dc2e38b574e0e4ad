/* Photographs at training size, decoded before their use.
 *
 * Order: every epoch is a new Fisher-Yates shuffle from (seed, level, epoch) alone. The photograph
 * of a step therefore does not depend on caches, threads or where a run was resumed. Memory:
 * decoded bytes are kept up to a limit, and the least recently used are dropped first. A photograph
 * that was returned is pinned until the next call. One thread decodes the photographs of the coming
 * steps while the device works.
 *
 * `lock` guards everything below it in struct photo_loader. Pixels of a slot that is READY and
 * pinned are read without it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <pthread.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "codec/scene/scene_photo.h"
#include "core/base.h"
#include "core/pool.h"
#include "core/splat/gauss.h"
#include "core/trace.h"
#include "train/base/config.h"
#include "train/photographs/photo_loader.h"

enum { PHOTO_LOADER_AHEAD = 3 };
enum photo_loader_state {
    PHOTO_LOADER_EMPTY,
    PHOTO_LOADER_LOADING,
    PHOTO_LOADER_READY,
    PHOTO_LOADER_FAILED
};

struct photo_loader_slot {
    enum photo_loader_state state;
    struct scene_photo photo;
    uint64_t used; /* clock of the last use */
};

struct photo_loader {
    struct photo_loader_config cfg;
    struct camera *cams; /* [n] at training size */
    unsigned *masks;     /* [n] of scene_photo_masks */
    struct pool_thread *thread;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    bool stop;
    struct photo_loader_slot *slots; /* [n] */
    size_t bytes;
    uint64_t clock;
    size_t pinned;                   /* slot handed out, or n */
    size_t want[PHOTO_LOADER_AHEAD]; /* slots to decode ahead, in order of use */
    size_t n_want;
    uint32_t *shuffle; /* [n], of epoch shuffle_epoch; used by callers of photo_loader_get only */
    uint64_t shuffle_epoch; /* 1-based, 0 = none yet */
    struct err fail;        /* why a slot failed */
};

struct camera photo_loader_camera(const struct camera *cam, uint32_t max_edge_px, double downsample)
{
    double w = cam->width_px, h = cam->height_px;
    double f = max_edge_px ? fmin(1.0, max_edge_px / fmax(w, h)) : 1.0;
    /* Round the finest size first: every level is then a division of the same picture. */
    w = fmax(floor(w * f + 0.5), 1.0);
    h = fmax(floor(h * f + 0.5), 1.0);
    w = fmax(floor(w / downsample + 0.5), 1.0);
    h = fmax(floor(h / downsample + 0.5), 1.0);
    return camera_resize(cam, (uint32_t)w, (uint32_t)h);
}

/* ---- decoding ---- */

static size_t photo_loader_size(const struct photo_loader *f, size_t slot)
{
    return (size_t)f->cams[slot].width_px * f->cams[slot].height_px * (f->masks[slot] ? 4 : 3);
}

static bool photo_loader_wanted(const struct photo_loader *f, size_t slot)
{
    for (size_t i = 0; i < f->n_want; i++)
        if (f->want[i] == slot)
            return true;
    return false;
}

/* Lock held. The least recently used slot that may go, or n_images. */
static size_t photo_loader_oldest(const struct photo_loader *f, bool even_wanted)
{
    size_t oldest = f->cfg.n_images;
    for (size_t i = 0; i < f->cfg.n_images; i++)
        if (f->slots[i].state == PHOTO_LOADER_READY && i != f->pinned &&
            (even_wanted || !photo_loader_wanted(f, i)) &&
            (oldest == f->cfg.n_images || f->slots[i].used < f->slots[oldest].used))
            oldest = i;
    return oldest;
}

/* Lock held. Make room for `need` more bytes as far as possible; what is wanted soon goes only when
 * the photograph wanted now has no place otherwise. */
static void photo_loader_evict(struct photo_loader *f, size_t need, bool even_wanted)
{
    while (f->bytes + need > f->cfg.cache_bytes) {
        size_t oldest = photo_loader_oldest(f, false);
        if (oldest == f->cfg.n_images && even_wanted)
            oldest = photo_loader_oldest(f, true);
        if (oldest == f->cfg.n_images)
            return;
        f->bytes -= photo_loader_size(f, oldest);
        scene_photo_free(&f->slots[oldest].photo);
        f->slots[oldest].state = PHOTO_LOADER_EMPTY;
    }
}

/* Cuts a picture to a part of it, in place. */
static void photo_loader_cut(struct image *img, const uint32_t part[4])
{
    size_t row = (size_t)part[2] * img->channels;
    if (!img->px)
        return;
    for (size_t y = 0; y < part[3]; y++)
        memmove(img->px + y * row,
                img->px + ((part[1] + y) * img->width_px + part[0]) * img->channels, row);
    img->width_px = part[2];
    img->height_px = part[3];
}

/* Reads the photograph of a slot, and cuts it to what is used of it. */
static enum err_code photo_loader_read(const struct photo_loader *f, size_t slot,
                                       struct scene_photo *out, struct err *e)
{
    const struct camera *full = &f->cfg.scene->images[f->cfg.images[slot]].cam;
    const struct camera cam = photo_loader_camera(full, f->cfg.max_edge_px, f->cfg.downsample);
    const struct scene_photo_form form = {.width_px = cam.width_px,
                                          .height_px = cam.height_px,
                                          .to_mean = f->cfg.exposure == PHOTO_LOADER_TO_MEAN,
                                          .masks = f->masks[slot]};
    enum err_code rc = scene_photo_read(f->cfg.scene, f->cfg.images[slot], &form, out, e);
    uint32_t part[4];
    if (rc || !f->cfg.windows)
        return rc;
    camera_window_px(&cam, &f->cfg.windows[slot], part);
    photo_loader_cut(&out->img, part);
    photo_loader_cut(&out->mask, part);
    return ERR_OK;
}

/* Lock held on entry and exit, released while decoding. */
static void photo_loader_load(struct photo_loader *f, size_t slot)
{
    struct scene_photo photo = {0};
    struct err e = {0};
    f->slots[slot].state = PHOTO_LOADER_LOADING;
    f->bytes += photo_loader_size(f, slot);
    pthread_mutex_unlock(&f->lock);
    double start_s = clock_s();
    enum err_code rc = photo_loader_read(f, slot, &photo, &e);
    trace_span("photographs", "read", start_s, clock_s());
    pthread_mutex_lock(&f->lock);
    f->slots[slot].state = rc ? PHOTO_LOADER_FAILED : PHOTO_LOADER_READY;
    f->slots[slot].photo = photo;
    f->slots[slot].used = ++f->clock;
    if (rc) {
        f->bytes -= photo_loader_size(f, slot);
        f->fail = e;
    }
    pthread_cond_broadcast(&f->changed);
}

/* Lock held. The next slot to decode ahead: only what fits beside all that is needed sooner. */
static size_t photo_loader_next_wanted(struct photo_loader *f)
{
    for (size_t i = 0; i < f->n_want; i++) {
        if (f->slots[f->want[i]].state != PHOTO_LOADER_EMPTY)
            continue;
        size_t need = photo_loader_size(f, f->want[i]);
        photo_loader_evict(f, need, false);
        return f->bytes + need <= f->cfg.cache_bytes ? f->want[i] : f->cfg.n_images;
    }
    return f->cfg.n_images;
}

static void photo_loader_thread(void *user)
{
    struct photo_loader *f = user;
    pthread_mutex_lock(&f->lock);
    while (!f->stop) {
        size_t slot = photo_loader_next_wanted(f);
        if (slot < f->cfg.n_images)
            photo_loader_load(f, slot);
        else
            pthread_cond_wait(&f->changed, &f->lock);
    }
    pthread_mutex_unlock(&f->lock);
}

/* ---- order ---- */

/* Fisher-Yates. */
static void photo_loader_shuffle(struct photo_loader *f, uint64_t epoch)
{
    uint64_t stream = train_stream(TRAIN_STREAM_SHUFFLE, f->cfg.level, epoch);
    uint32_t *a = f->shuffle;
    for (size_t i = 0; i < f->cfg.n_images; i++)
        a[i] = (uint32_t)i;
    for (size_t i = f->cfg.n_images; i-- > 1;) {
        size_t j = (size_t)(rng_unit(f->cfg.seed, stream, i) * (double)(i + 1));
        uint32_t swap = a[i];
        a[i] = a[j];
        a[j] = swap;
    }
}

static size_t photo_loader_slot_of(struct photo_loader *f, uint64_t step)
{
    size_t n = f->cfg.n_images;
    uint64_t epoch = (step - 1) / n + 1;
    if (f->shuffle_epoch != epoch)
        photo_loader_shuffle(f, epoch);
    f->shuffle_epoch = epoch;
    return f->shuffle[(step - 1) % n];
}

/* Lock held. Is there something for the thread to do? Where all is there it sleeps on: woken at
 * every step it would hold the lock while it waits for a core, and the next step would wait for it.
 */
static bool photo_loader_has_work(const struct photo_loader *f)
{
    for (size_t i = 0; i < f->n_want; i++)
        if (f->slots[f->want[i]].state == PHOTO_LOADER_EMPTY)
            return true;
    return false;
}

/* Wait for a slot, loading it here when the thread has not begun. */
static enum err_code photo_loader_take(struct photo_loader *f, size_t slot, const size_t *ahead,
                                       size_t n_ahead, struct photo *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    pthread_mutex_lock(&f->lock);
    f->pinned = slot;
    f->n_want = n_ahead;
    memcpy(f->want, ahead, n_ahead * sizeof *ahead);
    while (f->slots[slot].state != PHOTO_LOADER_READY && !rc) {
        if (f->slots[slot].state == PHOTO_LOADER_FAILED)
            rc = err_set(e, f->fail.code, "%s", f->fail.msg);
        else if (f->slots[slot].state == PHOTO_LOADER_EMPTY) {
            photo_loader_evict(f, photo_loader_size(f, slot), true);
            photo_loader_load(f, slot);
        } else
            pthread_cond_wait(&f->changed, &f->lock);
    }
    f->slots[slot].used = ++f->clock;
    if (photo_loader_has_work(f))
        pthread_cond_broadcast(&f->changed);
    pthread_mutex_unlock(&f->lock);
    if (rc)
        return rc;
    *out = (struct photo){.image = f->cfg.images[slot],
                          .cam = f->cams[slot],
                          .px = f->slots[slot].photo.img.px,
                          .mask = f->slots[slot].photo.mask.px,
                          .name = f->cfg.scene->images[f->cfg.images[slot]].name};
    if (f->cfg.exposure == PHOTO_LOADER_TOLD)
        memcpy(out->exposure_ev, f->cfg.scene->images[f->cfg.images[slot]].exposure_ev,
               sizeof out->exposure_ev);
    return ERR_OK;
}

enum err_code photo_loader_get(struct photo_loader *f, uint32_t step, struct photo *out,
                               struct err *e)
{
    size_t ahead[PHOTO_LOADER_AHEAD], n = 0;
    for (uint64_t d = 1; d <= PHOTO_LOADER_AHEAD && d < f->cfg.n_images; d++)
        ahead[n++] = photo_loader_slot_of(f, step + d);
    return photo_loader_take(f, photo_loader_slot_of(f, step), ahead, n, out, e);
}

enum err_code photo_loader_get_nth(struct photo_loader *f, size_t nth, struct photo *out,
                                   struct err *e)
{
    size_t next = nth + 1;
    if (nth >= f->cfg.n_images)
        return err_set(e, ERR_ARG, "photographs: %zu of %zu", nth, f->cfg.n_images);
    return photo_loader_take(f, nth, &next, next < f->cfg.n_images, out, e);
}

size_t photo_loader_bytes(const struct photo_loader *f)
{
    struct photo_loader *w =
        (struct photo_loader *)(uintptr_t)f; /* the lock is not part of the value */
    pthread_mutex_lock(&w->lock);
    size_t n = f->bytes;
    pthread_mutex_unlock(&w->lock);
    return n;
}

/* ---- life ---- */

enum err_code photo_loader_open(const struct photo_loader_config *cfg, struct photo_loader **out,
                                struct err *e)
{
    *out = NULL;
    if (!cfg->n_images)
        return err_set(e, ERR_DATA, "%s: no photographs to use", cfg->scene->dir);
    struct photo_loader *f = mem_array(1, sizeof *f);
    if (!f)
        return err_set(e, ERR_MEM, "photographs: out of memory");
    enum err_code rc = ERR_OK;
    f->cfg = *cfg;
    f->pinned = cfg->n_images;
    pthread_mutex_init(&f->lock, NULL);
    pthread_cond_init(&f->changed, NULL);
    f->cams = mem_array(cfg->n_images, sizeof *f->cams);
    f->masks = mem_array(cfg->n_images, sizeof *f->masks);
    f->slots = mem_array(cfg->n_images, sizeof *f->slots);
    f->shuffle = mem_array(cfg->n_images, sizeof *f->shuffle);
    if (!f->cams || !f->masks || !f->slots || !f->shuffle) {
        rc = err_set(e, ERR_MEM, "photographs: out of memory for %zu photographs", cfg->n_images);
        goto out;
    }
    for (size_t i = 0; !rc && i < cfg->n_images; i++) {
        f->cams[i] = photo_loader_camera(&cfg->scene->images[cfg->images[i]].cam, cfg->max_edge_px,
                                         cfg->downsample);
        if (cfg->windows)
            f->cams[i] = camera_crop(&f->cams[i], &cfg->windows[i]);
        rc = scene_photo_masks(cfg->scene, cfg->images[i], !cfg->no_masks,
                               cfg->exposure == PHOTO_LOADER_TO_MEAN, &f->masks[i], e);
    }
    if (!rc)
        rc = pool_start(photo_loader_thread, f, &f->thread, e);
out:
    if (rc)
        photo_loader_close(&f);
    *out = f;
    return rc;
}

void photo_loader_close(struct photo_loader **p)
{
    struct photo_loader *f = *p;
    if (!f)
        return;
    if (f->thread) {
        pthread_mutex_lock(&f->lock);
        f->stop = true;
        pthread_cond_broadcast(&f->changed);
        pthread_mutex_unlock(&f->lock);
        pool_join(&f->thread);
    }
    for (size_t i = 0; f->slots && i < f->cfg.n_images; i++)
        scene_photo_free(&f->slots[i].photo);
    mem_free(f->masks);
    pthread_cond_destroy(&f->changed);
    pthread_mutex_destroy(&f->lock);
    mem_free(f->cams);
    mem_free(f->slots);
    mem_free(f->shuffle);
    mem_free(f);
    *p = NULL;
}
