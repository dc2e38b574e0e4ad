/* A photograph of a scene, and its JSON. scene_image.def lists the fields.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SCENE_IMAGE_H
#define CODEC_SCENE_IMAGE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/splat/camera.h"

enum scene_split { SCENE_TRAIN, SCENE_TEST };
enum { SCENE_TIME_MAX = 20 };
/* What a field of each type of scene_image.def is in C. */
#define SCENE_C_NAME(member) char *member
#define SCENE_C_SPLIT(member) enum scene_split member
#define SCENE_C_COUNT(member) uint32_t member
#define SCENE_C_CAMERA(member) struct camera member
#define SCENE_C_PLACE(member) double member[3]
#define SCENE_C_NUMBER(member) double member
#define SCENE_C_STOPS(member) float member[3]
#define SCENE_C_TIME(member) char member[SCENE_TIME_MAX]
struct scene_image { /* a photograph; scene_image.def says what its members are */
#define FIELD(type, member, key, unit, what) SCENE_C_##type(member);
#include "codec/scene/scene_image.def"
#undef FIELD
};

/* Numbers as a JSON list. NULL: one is not finite, or out of memory. */
struct json_t *scene_image_numbers(const double *v, size_t n);
/* NULL: a number is not finite, a name is not UTF-8, or out of memory. */
struct json_t *scene_image_to_json(const struct scene_image *im);
/* The name lives in the arena. ERR_FORMAT names the key. ERR_MEM. */
enum err_code scene_image_from_json(const struct json_t *o, struct scene_image *im, struct arena *a,
                                    struct err *e) ERR_USE;
/* Converts EXIF's "2024:06:01 10:00:00" to the form of a scene. Anything else becomes "". */
void scene_time(const char *exif, char out[SCENE_TIME_MAX]);

#endif
