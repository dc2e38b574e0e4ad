/* What determines the bytes of each kind of drawn result.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/picture_id.h"

#include <stdio.h>
#include <string.h>

#include "server/documents/result_id.h"

/* Raise it when a question that was drawn before is drawn otherwise: what is kept on disk then has
 * another name. 2: sky and ground follow the light of the city. */
enum { PICTURE_ID_DRAWING = 2 };

void picture_id_edition(const struct dataset *d, const char *device, int quality, int supersample,
                        double gaussians, char out[9])
{
    struct { /* no padding */
        struct hash128 salt;
        char device[160];
        double quality, supersample, gaussians, drawing;
    } name = {.salt = d->salt,
              .quality = quality,
              .supersample = supersample,
              .gaussians = gaussians,
              .drawing = PICTURE_ID_DRAWING};
    snprintf(name.device, sizeof name.device, "%s", device);
    result_id_edition(&name, sizeof name, out);
}

struct hash128 picture_id_view(const struct dataset *d, const char *device,
                               const struct draw_view *v, const struct appearance_choice *a,
                               double gaussians)
{
    const struct camera *cam = &v->cam;
    const struct composite *paint = &v->composite;
    struct {
        struct hash128 salt;
        char rev[16], device[160];
        double rot[9], trans[3], focal[4], gaussians;
        uint32_t width, height, format, quality, background, rgb, depth, supersample, moves,
            drawing;
    } name;
    memset(&name, 0, sizeof name);
    name.salt = d->salt;
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    snprintf(name.device, sizeof name.device, "%s", device);
    memcpy(name.rot, cam->rot, sizeof name.rot);
    memcpy(name.trans, cam->trans, sizeof name.trans);
    name.focal[0] = cam->fx_px;
    name.focal[1] = cam->fy_px;
    name.focal[2] = cam->cx_px;
    name.focal[3] = cam->cy_px;
    name.width = cam->width_px;
    name.height = cam->height_px;
    name.format = (uint32_t)v->format;
    name.quality = (uint32_t)v->quality;
    name.background = (uint32_t)paint->background;
    name.rgb = paint->rgb;
    name.depth = (uint32_t)paint->depth;
    name.supersample = paint->supersample;
    name.moves = v->moves;
    name.drawing = PICTURE_ID_DRAWING;
    name.gaussians = gaussians;
    struct hash128 id = hash_bytes(&name, sizeof name);
    result_id_mix(&id, a);
    return id;
}

struct hash128 picture_id_map(const struct dataset *d, const char *device, const struct map_tile *t,
                              bool flat, const struct appearance_choice *a)
{
    struct { /* no padding */
        struct hash128 salt;
        char rev[16], device[160], kind[8];
        uint32_t z, x, y, size, format, encoding, quality, flat;
    } name = {.salt = d->salt,
              .kind = "map",
              .z = flat ? 0 : t->key.z,
              .x = flat ? 0 : t->key.x,
              .y = flat ? 0 : t->key.y,
              .size = t->size_px,
              .format = (uint32_t)t->format,
              .encoding = (uint32_t)t->encoding,
              .quality = (uint32_t)t->quality,
              .flat = (uint32_t)flat | (uint32_t)(t->ground && !flat) << 1};
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    snprintf(name.device, sizeof name.device, "%s", device);
    struct hash128 id = hash_bytes(&name, sizeof name);
    result_id_mix(&id, a);
    return id;
}

struct hash128 picture_id_query(const struct dataset *d, const char *device, const char *geoid,
                                const struct query *q)
{
    struct {
        struct hash128 salt, question, geoid;
        char rev[16], device[160];
    } name = {.salt = d->salt,
              .question = hash_bytes(q, sizeof *q),
              .geoid = hash_bytes(geoid, strlen(geoid))};
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    snprintf(name.device, sizeof name.device, "%s", device);
    return hash_bytes(&name, sizeof name);
}
