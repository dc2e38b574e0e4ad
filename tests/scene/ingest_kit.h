/* Ingesting small procedural cities: their options, and what is read of the result.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_INGEST_KIT_H
#define TESTS_INGEST_KIT_H

#include "tests/scene/city_kit.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "scene/ingest/ingest.h"

static const double tol_place_m = 0.02; /* EXIF rounding, averaged over the photographs */
static struct arena config_texts;

static inline void join(char *out, const char *a, const char *b)
{
    struct err e = {0};
    kit_ok(file_join(out, a, b, &e), e);
}

static inline void city_config(struct synth_config *c, char *dir, const char *name)
{
    join(dir, kit_tmp, name);
    city_kit_config(c, &config_texts, dir, 32);
}

static inline void ingest_config(struct ingest_config *c, char *dir, const char *name)
{
    struct err e = {0};
    kit_ok(options_defaults(ingest_options(), c, &config_texts, &e), e);
    join(dir, kit_tmp, name);
    c->output = dir;
}

static inline enum err_code ingest_city(const char *city, const struct ingest_config *cfg,
                                        struct err *e)
{
    char images[FILE_PATH_MAX];
    join(images, city, "images");
    return ingest_run(images, city, cfg, e);
}

static inline json_t *read_json(const char *dir, const char *name)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    json_t *root;
    join(path, dir, name);
    kit_ok(jsonc_read(path, &root, &e), e);
    return root;
}

/* Median distance in pixels between tracks and their projected points. */
static inline double track_error(const struct scene *s)
{
    double *v = mem_array(s->n_tracks, sizeof *v);
    for (size_t k = 0; k < s->n_tracks; k++) {
        const struct scene_track *t = &s->tracks[k];
        const struct camera *c = &s->images[t->image].cam;
        const double *x = s->points[t->point].enu_m;
        double p[3];
        for (int a = 0; a < 3; a++)
            p[a] = c->rot[3 * a] * x[0] + c->rot[3 * a + 1] * x[1] + c->rot[3 * a + 2] * x[2] +
                   c->trans[a];
        v[k] = hypot(c->fx_px * p[0] / p[2] + c->cx_px - (double)t->x_px,
                     c->fy_px * p[1] / p[2] + c->cy_px - (double)t->y_px);
    }
    double median = sort_median(v, s->n_tracks);
    mem_free(v);
    return median;
}

static inline size_t dropped_as(const json_t *report, const char *what, size_t *n)
{
    const json_t *photos = json_object_get(report, "photos");
    size_t hits = 0;
    *n = 0;
    for (size_t i = 0; i < json_array_size(photos); i++) {
        const char *why = json_string_value(json_object_get(json_array_get(photos, i), "why"));
        *n += why[0] != 0;
        hits += strstr(why, what) != NULL;
    }
    return hits;
}

static inline int ingest_kit_teardown(void **state)
{
    kit_tmp_remove(state);
    arena_free(&config_texts);
    return 0;
}

#endif
