/* COLMAP's text files: cameras.txt, images.txt, points3D.txt.
 *
 *     cameras.txt   ID MODEL WIDTH HEIGHT PARAMS...
 *     images.txt    ID QW QX QY QZ TX TY TZ CAMERA_ID NAME
 *                   X Y POINT_ID ...            (the next line; it may be empty)
 *     points3D.txt  ID X Y Z R G B ERROR IMAGE_ID OBS ...
 *
 * Lines that start with # are comments. Some programs leave out the line of observations where
 * there are none. The number of records is not known beforehand: records are
 * collected in a growing list and moved to the model's arena at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/colmap_parse.h"

struct lines { /* hands out the lines of a buffer, NUL-terminated, without blanks around them */
    char *p, *end;
    size_t number;
};

static char *txt_line_next(struct lines *l)
{
    if (l->p >= l->end)
        return NULL;
    char *s = l->p, *nl = memchr(s, '\n', (size_t)(l->end - s));
    char *stop = nl ? nl : l->end;
    l->p = nl ? nl + 1 : l->end;
    l->number++;
    while (stop > s && (stop[-1] == ' ' || stop[-1] == '\r' || stop[-1] == '\t'))
        stop--;
    *stop = 0;
    return s + strspn(s, " \t");
}

/* The next line with a record in it. */
static char *txt_record_next(struct lines *l)
{
    char *s;
    do
        s = txt_line_next(l);
    while (s && (!*s || *s == '#'));
    return s;
}

/* The buffer ends in the NUL byte the caller added; another one before it means this is no text. */
static enum err_code txt_lines_open(struct buf *file, const char *name, struct lines *l,
                                    struct err *e)
{
    char *text = (char *)file->data;
    if (memchr(text, 0, file->size) != text + file->size - 1)
        return err_set(e, ERR_FORMAT, "%s: holds a NUL byte: not a text file", name);
    *l = (struct lines){.p = text, .end = text + file->size - 1};
    if (!strncmp(text, "\xef\xbb\xbf", 3)) /* the byte-order mark of UTF-8 */
        l->p += 3;
    return ERR_OK;
}

static bool txt_number_next(char **s, double *out)
{
    char *end;
    *s += strspn(*s, " \t");
    *out = strtod(*s, &end);
    if (end == *s || (*end && *end != ' ' && *end != '\t'))
        return false;
    *s = end;
    return true;
}

static bool txt_id_next(char **s, uint64_t *out)
{
    char *end;
    *s += strspn(*s, " \t");
    bool negative = **s == '-';
    errno = 0;
    unsigned long long v = strtoull(*s, &end, 10);
    if (end == *s || errno || (*end && *end != ' ' && *end != '\t'))
        return false;
    if (negative && v != ULLONG_MAX) /* only -1, "none", may be negative */
        return false;
    *s = end;
    *out = v;
    return true;
}

static bool txt_id32_next(char **s, uint32_t *out)
{
    uint64_t v;
    if (!txt_id_next(s, &v) || v > UINT32_MAX)
        return false;
    *out = (uint32_t)v;
    return true;
}

static size_t txt_word_count(const char *s)
{
    size_t n = 0;
    for (s += strspn(s, " \t"); *s; s += strspn(s, " \t")) {
        n++;
        s += strcspn(s, " \t");
    }
    return n;
}

static bool txt_at_end(const char *s)
{
    return s[strspn(s, " \t")] == 0;
}

static void txt_line_error(const char *name, const struct lines *l, const char *why, struct err *e)
{
    err_set(e, ERR_FORMAT, "%s: line %zu: %s", name, l->number, why);
}

static char *txt_word_next(char **s)
{
    *s += strspn(*s, " \t");
    char *w = *s;
    *s += strcspn(*s, " \t");
    if (**s)
        *(*s)++ = 0;
    return w;
}

static enum err_code txt_camera_line(char *s, struct colmap_camera *cam, struct err *e)
{
    if (!txt_id32_next(&s, &cam->id))
        return err_set(e, ERR_FORMAT, "expected a camera id");
    struct colmap_lens lens;
    double params[COLMAP_PARAMS_MAX];
    const char *model = txt_word_next(&s);
    if (!colmap_lens_find(model, 0, &lens))
        return err_set(e, ERR_FORMAT, "camera model '%.40s' is none of COLMAP's", model);
    uint32_t w, h;
    if (!txt_id32_next(&s, &w) || !txt_id32_next(&s, &h) || !w || !h || w > 1 << 20 || h > 1 << 20)
        return err_set(e, ERR_FORMAT, "expected width and height in pixels");
    cam->lens.width_px = w;
    cam->lens.height_px = h;
    for (size_t k = 0; k < lens.n_params; k++)
        if (!txt_number_next(&s, &params[k]))
            return err_set(e, ERR_FORMAT, "%s needs %zu parameters", lens.name, lens.n_params);
    if (!txt_at_end(s))
        return err_set(e, ERR_FORMAT, "%s has only %zu parameters", lens.name, lens.n_params);
    const char *why = colmap_set_lens(&lens, params, cam);
    return why ? err_set(e, ERR_FORMAT, "%s", why) : ERR_OK;
}

/* ---- growing lists ---- */

struct list {
    void *data;
    size_t n, cap, size; /* of one entry */
};

/* A zeroed new entry, NULL when out of memory. */
static void *txt_list_add(struct list *l)
{
    if (l->n == l->cap) {
        size_t want = l->cap ? l->cap * 2 : 64;
        void *grown = mem_resize(l->data, l->cap, want, l->size);
        if (!grown)
            return NULL;
        l->data = grown;
        l->cap = want;
    }
    return (char *)l->data + l->n++ * l->size;
}

/* Copy into the arena and free the list; NULL when out of memory. */
static void *txt_list_move(struct list *l, struct arena *a)
{
    void *out = arena_get(a, l->n, l->size);
    if (out && l->n)
        memcpy(out, l->data, l->n * l->size);
    mem_free(l->data);
    l->data = NULL;
    return out;
}

/* ---- files ---- */

static enum err_code txt_no_memory(const char *name, struct err *e)
{
    return err_set(e, ERR_MEM, "%s: out of memory", name);
}

enum err_code colmap_txt_cameras(struct buf *file, struct colmap_model *m, struct err *e)
{
    static const char name[] = "cameras.txt";
    struct lines l;
    struct list cameras = {.size = sizeof *m->cameras};
    enum err_code rc = txt_lines_open(file, name, &l, e);
    for (char *s; !rc && (s = txt_record_next(&l));) {
        struct colmap_camera *cam = txt_list_add(&cameras);
        struct err inner = {0};
        if (!cam)
            rc = txt_no_memory(name, e);
        else if ((rc = txt_camera_line(s, cam, &inner)) != ERR_OK)
            txt_line_error(name, &l, inner.msg, e);
    }
    m->n_cameras = cameras.n;
    m->cameras = txt_list_move(&cameras, &m->arena);
    return !rc && !m->cameras ? txt_no_memory(name, e) : rc;
}

static enum err_code txt_image_line(char *s, struct colmap_image *im, struct arena *a,
                                    struct err *e)
{
    uint32_t camera;
    if (!txt_id32_next(&s, &im->id))
        return err_set(e, ERR_FORMAT, "expected an image id");
    for (int k = 0; k < 4; k++)
        if (!txt_number_next(&s, &im->quat_wxyz[k]))
            return err_set(e, ERR_FORMAT, "expected QW QX QY QZ");
    for (int k = 0; k < 3; k++)
        if (!txt_number_next(&s, &im->trans[k]))
            return err_set(e, ERR_FORMAT, "expected TX TY TZ");
    if (!txt_id32_next(&s, &camera))
        return err_set(e, ERR_FORMAT, "expected a camera id");
    im->camera = camera;
    im->name =
        arena_text(a, s + strspn(s, " \t")); /* the rest of the line: names may hold blanks */
    return im->name ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
}

static enum err_code txt_observations_line(char *s, struct colmap_image *im, struct arena *a,
                                           struct err *e)
{
    size_t words = txt_word_count(s);
    if (words % 3)
        return err_set(e, ERR_FORMAT, "observations come in threes: X Y POINT_ID; found %zu words",
                       words);
    im->n_obs = words / 3;
    im->obs = arena_get(a, im->n_obs, sizeof *im->obs);
    if (!im->obs)
        return err_set(e, ERR_MEM, "out of memory");
    for (size_t j = 0; j < im->n_obs; j++) {
        uint64_t id;
        if (!txt_number_next(&s, &im->obs[j].x_px) || !txt_number_next(&s, &im->obs[j].y_px) ||
            !txt_id_next(&s, &id))
            return err_set(e, ERR_FORMAT, "observation %zu: expected X Y POINT_ID", j);
        im->obs[j].point = (int64_t)id;
    }
    return ERR_OK;
}

/* Is it a photograph's line, and not one of observations? Its tenth word is a name. */
static bool txt_is_image(const char *s)
{
    char *end;
    for (int k = 0; k < 9; k++) {
        (void)strtod(s, &end);
        if (end == s)
            return false;
        s = end;
    }
    (void)strtod(s, &end);
    return !txt_at_end(s) && (end == s || (*end && *end != ' ' && *end != '\t'));
}

enum err_code colmap_txt_images(struct buf *file, struct colmap_model *m, struct err *e)
{
    static const char name[] = "images.txt";
    struct lines l;
    struct list images = {.size = sizeof *m->images};
    enum err_code rc = txt_lines_open(file, name, &l, e);
    bool again = false; /* s is the next record */
    char none[1] = "";
    for (char *s = NULL; !rc && (again || (s = txt_record_next(&l)));) {
        struct colmap_image *im = txt_list_add(&images);
        struct err inner = {0};
        if (!im) {
            rc = txt_no_memory(name, e);
            break;
        }
        rc = txt_image_line(s, im, &m->arena, &inner);
        if (!rc) {
            s = txt_line_next(&l);
            again = s && txt_is_image(s);
            rc = txt_observations_line(s && !again ? s : none, im, &m->arena, &inner);
        }
        const char *why = !rc ? colmap_check_image(im) : NULL;
        if (why)
            rc = err_set(&inner, ERR_FORMAT, "image '%.200s': %s", im->name, why);
        if (rc)
            txt_line_error(name, &l, inner.msg, e);
    }
    m->n_images = images.n;
    m->images = txt_list_move(&images, &m->arena);
    return !rc && !m->images ? txt_no_memory(name, e) : rc;
}

static enum err_code txt_point_line(char *s, struct colmap_point *p, struct list *tracks,
                                    struct err *e)
{
    if (!txt_id_next(&s, &p->id))
        return err_set(e, ERR_FORMAT, "expected a point id");
    for (int k = 0; k < 3; k++)
        if (!txt_number_next(&s, &p->xyz[k]))
            return err_set(e, ERR_FORMAT, "expected X Y Z");
    for (int k = 0; k < 3; k++) {
        uint32_t v;
        if (!txt_id32_next(&s, &v) || v > 255)
            return err_set(e, ERR_FORMAT, "expected R G B, 0 to 255");
        p->rgb[k] = (uint8_t)v;
    }
    if (!txt_number_next(&s, &p->error_px))
        return err_set(e, ERR_FORMAT, "expected a reprojection error");
    p->track = tracks->n;
    while (!txt_at_end(s)) {
        struct colmap_track_element *t = txt_list_add(tracks);
        if (!t)
            return err_set(e, ERR_MEM, "out of memory");
        if (!txt_id32_next(&s, &t->image) || !txt_id32_next(&s, &t->obs))
            return err_set(e, ERR_FORMAT, "track element %zu: expected IMAGE_ID OBS", p->n_track);
        p->n_track++;
    }
    return ERR_OK;
}

enum err_code colmap_txt_points(struct buf *file, struct colmap_model *m, struct err *e)
{
    static const char name[] = "points3D.txt";
    struct lines l;
    struct list points = {.size = sizeof *m->points}, tracks = {.size = sizeof *m->tracks};
    enum err_code rc = txt_lines_open(file, name, &l, e);
    for (char *s; !rc && (s = txt_record_next(&l));) {
        struct colmap_point *p = txt_list_add(&points);
        struct err inner = {0};
        if (!p)
            rc = txt_no_memory(name, e);
        else if ((rc = txt_point_line(s, p, &tracks, &inner)) != ERR_OK)
            txt_line_error(name, &l, inner.msg, e);
    }
    m->n_points = points.n;
    m->n_tracks = tracks.n;
    m->points = txt_list_move(&points, &m->arena);
    m->tracks = txt_list_move(&tracks, &m->arena);
    return !rc && (!m->points || !m->tracks) ? txt_no_memory(name, e) : rc;
}
