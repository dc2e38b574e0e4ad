/* Which photographs test: see ingest_internal.h.
 *
 * A photograph that alone shows its ground cannot test: nothing that trains has seen it, and what
 * it shows is missing from the city. Surveys with gaps have such photographs at the ends of their
 * lines. One whose ground is not covered by two others gives its place to that of its neighbours in
 * order whose ground is covered best. Surveys with the usual overlap keep every n-th.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "scene/ingest/ingest_internal.h"

enum { SPLIT_COLUMNS = 8, SPLIT_ROWS = 6, SPLIT_OTHERS = 2, SPLIT_STEPS = 7 };
static const double split_covered = 0.65; /* of a picture's ground: enough */
static const double split_gain = 0.1;     /* more, for a neighbour to be taken */
static const double split_far = 2;        /* others are at most so many times as far away */

/* Where the ray through a part of the picture meets the plane at ground_m; false above the
 * horizon. */
static bool split_ground(const struct camera *c, double u, double v, double ground_m, double out[3])
{
    double eye[3], ray[3];
    camera_center(c, eye);
    camera_ray(c, u * c->width_px, v * c->height_px, ray);
    double t = (ground_m - eye[2]) / ray[2];
    for (int k = 0; k < 3; k++)
        out[k] = eye[k] + t * ray[k];
    return isfinite(t) && t > 0.0;
}

static double split_apart2(const double a[3], const double b[3])
{
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

/* Does photograph k train, and show the place from not too far away? k may be no photograph. */
static bool split_shows(const struct scene *s, size_t k, const double place[3], double most2)
{
    double eye[3];
    if (k >= s->n_images || s->images[k].split == SCENE_TEST)
        return false;
    camera_center(&s->images[k].cam, eye);
    return split_apart2(eye, place) <= most2 && camera_frames(&s->images[k].cam, place, 0.0, NULL);
}

/* Is the place shown by two photographs that train, other than photograph i? Neighbours in order
 * are asked first: they mostly do. */
static bool split_is_shown(const struct scene *s, size_t i, const double place[3])
{
    double eye[3];
    int n = 0;
    camera_center(&s->images[i].cam, eye);
    double most2 = split_far * split_far * split_apart2(eye, place);
    for (size_t step = 1; step < s->n_images && n < SPLIT_OTHERS; step++)
        n += split_shows(s, i + step, place, most2) + split_shows(s, i - step, place, most2);
    return n >= SPLIT_OTHERS;
}

/* The part of a photograph's ground that others show; 1 where it shows none. */
static double split_cover(const struct scene *s, size_t i, double ground_m)
{
    size_t shown = 0, n = 0;
    for (int row = 0; row < SPLIT_ROWS; row++)
        for (int col = 0; col < SPLIT_COLUMNS; col++) {
            double place[3];
            if (!split_ground(&s->images[i].cam, (col + 0.5) / SPLIT_COLUMNS,
                              (row + 0.5) / SPLIT_ROWS, ground_m, place))
                continue;
            shown += split_is_shown(s, i, place);
            n++;
        }
    return n ? (double)shown / (double)n : 1.0;
}

/* The photograph that tests instead of photograph i; i itself where it is covered. */
static size_t split_instead(struct scene *s, size_t i, double ground_m)
{
    size_t best = i;
    double most = split_cover(s, i, ground_m);
    if (most >= split_covered)
        return i;
    most += split_gain;
    s->images[i].split = SCENE_TRAIN;
    for (size_t step = 1; step <= SPLIT_STEPS; step++)
        for (int side = 0; side < 2; side++) {
            size_t k = side ? i - step : i + step; /* wraps below 0: too large then */
            if (k >= s->n_images || s->images[k].split == SCENE_TEST)
                continue;
            double cover = split_cover(s, k, ground_m);
            if (cover > most) {
                most = cover;
                best = k;
            }
        }
    s->images[best].split = SCENE_TEST;
    return best;
}

enum err_code ingest_split_cover(struct scene *s, struct err *e)
{
    double *heights = mem_array(s->n_points, sizeof *heights);
    size_t n = 0, moved = 0;
    bool *asked = mem_array(s->n_images, sizeof *asked);
    if (!heights || !asked) {
        mem_free(heights);
        mem_free(asked);
        return err_set(e, ERR_MEM, "ingest: out of memory");
    }
    for (size_t i = 0; i < s->n_points; i++)
        if (isfinite(s->points[i].enu_m[2]))
            heights[n++] = s->points[i].enu_m[2];
    double ground_m = n ? sort_median(heights, n) : 0.0;
    for (size_t i = 0; i < s->n_images; i++)
        asked[i] = s->images[i].split == SCENE_TEST;
    for (size_t i = 0; i < s->n_images; i++)
        if (n && asked[i])
            moved += split_instead(s, i, ground_m) != i;
    if (moved)
        log_info("ingest",
                 "%zu photographs whose ground others hardly show train, and neighbours of theirs "
                 "test instead",
                 moved);
    mem_free(heights);
    mem_free(asked);
    return ERR_OK;
}
