/* See scene_photo.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/scene_photo.h"

#include <string.h>

#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "core/splat/exposure.h"

/* The exposure that a photograph is brought to the mean from; NULL: it stays as it is. */
static const float *scene_photo_exposure(const struct scene_image *im, bool to_mean)
{
    return to_mean && !exposure_is_mean(im->exposure_ev) ? im->exposure_ev : NULL;
}

static enum err_code scene_photo_mask_path(const struct scene *s, uint32_t image,
                                           char out[FILE_PATH_MAX], struct err *e)
{
    char dir[FILE_PATH_MAX];
    enum err_code rc = file_join(dir, s->dir, "masks", e);
    return rc ? rc : mask_path(dir, s->images[image].name, out, e);
}

enum err_code scene_photo_masks(const struct scene *s, uint32_t image, bool files, bool to_mean,
                                unsigned *out, struct err *e)
{
    const uint8_t white[3] = {255, 255, 255};
    const float *ev = scene_photo_exposure(&s->images[image], to_mean);
    char path[FILE_PATH_MAX];
    enum err_code rc = scene_photo_mask_path(s, image, path, e);
    *out = (!rc && files && file_exists(path) ? SCENE_PHOTO_FILE : 0) |
           (ev && exposure_clipped(ev, white) ? SCENE_PHOTO_CLIPPED : 0);
    return rc;
}

static enum err_code scene_photo_image(const struct scene *s, const struct scene_image *im,
                                       const struct scene_photo_form *form, struct image *out,
                                       struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct image full = {0};
    enum err_code rc = file_join(dir, s->dir, "images", e);
    if (!rc)
        rc = file_join(path, dir, im->name, e);
    if (!rc)
        rc = image_read(path, NULL, &full, e);
    if (rc == ERR_FORMAT || rc == ERR_NOENT || rc == ERR_IO)
        return err_add(e, "a photograph of the scene is gone or broken: ingest the scene again");
    if (rc)
        return rc;
    if (full.channels != 3 || full.width_px != im->cam.width_px ||
        full.height_px != im->cam.height_px) {
        rc = err_set(e, ERR_DATA,
                     "%s: %u x %u pixels, the scene says %u x %u: ingest the scene again", path,
                     full.width_px, full.height_px, im->cam.width_px, im->cam.height_px);
    } else if (full.width_px == form->width_px && full.height_px == form->height_px) {
        *out = full;
        return ERR_OK;
    } else {
        rc = image_resize(&full, form->width_px, form->height_px, out, e);
    }
    image_free(&full);
    return rc;
}

static enum err_code scene_photo_mask(const struct scene *s, uint32_t image,
                                      const struct scene_photo_form *form, struct image *out,
                                      struct err *e)
{
    const struct camera *full = &s->images[image].cam;
    char path[FILE_PATH_MAX];
    struct image whole = {0};
    enum err_code rc = scene_photo_mask_path(s, image, path, e);
    if (!rc)
        rc = mask_read(path, full->width_px, full->height_px, &whole, e);
    if (!rc)
        rc = mask_resize(&whole, form->width_px, form->height_px, out, e);
    image_free(&whole);
    return rc;
}

/* What was clipped is darker now than it may have been: masked. */
static enum err_code scene_photo_to_mean(const float *ev, bool clipped, struct scene_photo *p,
                                         struct err *e)
{
    size_t n = (size_t)p->img.width_px * p->img.height_px;
    if (clipped && !p->mask.px) {
        enum err_code rc = image_alloc(p->img.width_px, p->img.height_px, 1, &p->mask, e);
        if (rc)
            return rc;
        memset(p->mask.px, 255, n);
    }
    exposure_to_mean(ev, p->img.px, n, p->mask.px);
    return ERR_OK;
}

enum err_code scene_photo_read(const struct scene *s, uint32_t image,
                               const struct scene_photo_form *form, struct scene_photo *out,
                               struct err *e)
{
    const struct scene_image *im = &s->images[image];
    const float *ev = scene_photo_exposure(im, form->to_mean);
    *out = (struct scene_photo){0};
    enum err_code rc = scene_photo_image(s, im, form, &out->img, e);
    if (!rc && form->masks & SCENE_PHOTO_FILE)
        rc = scene_photo_mask(s, image, form, &out->mask, e);
    if (!rc && ev)
        rc = scene_photo_to_mean(ev, form->masks & SCENE_PHOTO_CLIPPED, out, e);
    if (rc)
        scene_photo_free(out);
    return rc;
}

void scene_photo_free(struct scene_photo *p)
{
    image_free(&p->img);
    image_free(&p->mask);
}
