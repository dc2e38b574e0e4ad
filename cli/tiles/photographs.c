/* Blobs about photographs. A thumbnail is the undistorted photograph, 160 pixels along its longer
 * side, as a JPEG of the best quality that takes no more than 6 KiB.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/tiles/photographs.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "core/pool.h"
#include "core/splat/appearance.h"
#include "lod/store/photograph.h"

struct photographs_one {
    const struct scene_image *image;
    char about_name[PHOTOGRAPH_NAME_MAX], thumbnail_name[PHOTOGRAPH_NAME_MAX];
    struct buf about, thumbnail;
};
struct photographs_job {
    const struct scene *scene;
    struct photographs_one *all;
    bool thumbnails;
};

/* Where a camera stands and looks, in the axes at the scene's origin. */
static enum err_code photographs_pose(const struct scene *s, const struct camera *c,
                                      struct photograph *out, struct err *e)
{
    double enu_m[3];
    const double *ahead = c->rot + 6, *down = c->rot + 3;
    camera_center(c, enu_m);
    double level = hypot(ahead[0], ahead[1]);
    /* straight down, the upper edge of the picture says where north is */
    const double *to = level > 1e-3 ? ahead : (const double[]){-down[0], -down[1]};
    out->heading_deg = fmod(atan2(to[0], to[1]) * 180 / M_PI + 360, 360);
    out->pitch_deg = atan2(ahead[2], level) * 180 / M_PI;
    out->fov_y_deg = 2 * atan(c->height_px / (2 * c->fy_px)) * 180 / M_PI;
    return geo_from_enu(&s->origin, enu_m, &out->lon_deg, &out->lat_deg, &out->h_m, e);
}

static enum err_code photographs_shrink(const char *path, struct image *out, struct err *e)
{
    struct image full = {0};
    enum err_code rc = image_read(path, NULL, &full, e);
    if (!rc) {
        uint32_t most = full.width_px > full.height_px ? full.width_px : full.height_px;
        double share = most > PHOTOGRAPH_EDGE_PX ? (double)PHOTOGRAPH_EDGE_PX / most : 1.0;
        uint32_t w = (uint32_t)lround(full.width_px * share),
                 h = (uint32_t)lround(full.height_px * share);
        rc = image_resize(&full, w ? w : 1, h ? h : 1, out, e);
    }
    image_free(&full);
    return rc;
}

static enum err_code photographs_thumbnail(const char *path, struct buf *out, struct err *e)
{
    static const int qualities[] = {85, 75, 65, 50, 35, 20, 10};
    struct image small = {0};
    enum err_code rc = photographs_shrink(path, &small, e);
    for (size_t i = 0; !rc && i < sizeof qualities / sizeof *qualities; i++) {
        buf_free(out);
        rc = image_encode(&small, "jpg", qualities[i], out, e);
        if (out->size <= PHOTOGRAPH_BYTES_MAX)
            break;
    }
    image_free(&small);
    return rc;
}

static enum err_code photographs_make(void *user, size_t i, struct err *e)
{
    const struct photographs_job *j = user;
    struct photographs_one *one = &j->all[i];
    struct photograph about = {0};
    struct err why = {0};
    char path[FILE_PATH_MAX], file[FILE_PATH_MAX];
    memcpy(about.time, one->image->time, sizeof about.time);
    enum err_code rc = photograph_blob(PHOTOGRAPH_BLOB, one->image->name, one->about_name, e);
    if (!rc)
        rc = photograph_blob(PHOTOGRAPH_THUMBNAIL, one->image->name, one->thumbnail_name, e);
    if (!rc && j->thumbnails) {
        if (file_join(path, j->scene->dir, "images", &why) ||
            file_join(file, path, one->image->name, &why) ||
            photographs_thumbnail(file, &one->thumbnail, &why)) {
            log_warn("tile", "no thumbnail of a photograph: %s", why.msg);
            buf_free(&one->thumbnail);
        }
        about.has_thumbnail = one->thumbnail.size > 0;
    }
    if (!rc)
        rc = photographs_pose(j->scene, &one->image->cam, &about, e);
    if (!rc)
        rc = photograph_write(&about, &one->about, e);
    return rc;
}

enum err_code photographs_of(const struct scene *s, const struct appearance *a, bool thumbnails,
                             struct photographs *out, struct err *e)
{
    *out = (struct photographs){0};
    out->all = mem_array(s->n_images, sizeof *out->all);
    out->blobs = mem_array(s->n_images, 2 * sizeof *out->blobs);
    if (!out->all || !out->blobs) {
        photographs_free(out);
        return err_set(e, ERR_MEM, "out of memory for %zu photographs", s->n_images);
    }
    for (size_t i = 0; i < s->n_images; i++)
        if (appearance_find(a, s->images[i].name) >= 0)
            out->all[out->n++].image = &s->images[i];
    struct photographs_job j = {s, out->all, thumbnails};
    enum err_code rc = pool_for(out->n, 0, photographs_make, &j, e);
    for (size_t i = 0; !rc && i < out->n; i++) {
        struct photographs_one *one = &out->all[i];
        out->blobs[out->n_blobs++] =
            (struct store_blob){one->about_name, one->about.data, one->about.size};
        if (one->thumbnail.size)
            out->blobs[out->n_blobs++] =
                (struct store_blob){one->thumbnail_name, one->thumbnail.data, one->thumbnail.size};
        out->thumbnail_bytes += one->thumbnail.size;
    }
    if (rc)
        photographs_free(out);
    return rc;
}

void photographs_free(struct photographs *p)
{
    for (size_t i = 0; p->all && i < p->n; i++) {
        buf_free(&p->all[i].about);
        buf_free(&p->all[i].thumbnail);
    }
    mem_free(p->all);
    mem_free(p->blobs);
    *p = (struct photographs){0};
}
