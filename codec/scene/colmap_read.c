/* Reads COLMAP sparse models: finds the files, resolves ids, and checks records.
 *
 * COLMAP writes a model as three files, binary or text, that refer to each other by id. The readers
 * (colmap_bin.c, colmap_txt.c) take records as they come. Here all records are sorted by id, and
 * every reference becomes a checked index. Code that uses a model never looks up an id. Then
 * colmap_tracks.c checks tracks against observations.
 * Source: https://colmap.github.io/format.html
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/colmap_parse.h"

enum {
    PART_COUNT = 3,
    MODELS_GAP = 16 /* numbers without a model that end the search */
};
static const char *const part_names[PART_COUNT] = {"cameras", "images", "points3D"};

void colmap_free(struct colmap_model *m)
{
    arena_free(&m->arena);
    *m = (struct colmap_model){0};
}

/* ---- ids to indices ---- */

static int colmap_camera_compare(const void *a, const void *b)
{
    const struct colmap_camera *p = a, *q = b;
    if (!p->foreign != !q->foreign) /* foreign ones last */
        return p->foreign ? 1 : -1;
    return (p->id > q->id) - (p->id < q->id);
}

static int colmap_image_compare(const void *a, const void *b)
{
    const struct colmap_image *p = a, *q = b;
    return (p->id > q->id) - (p->id < q->id);
}

static int colmap_point_compare(const void *a, const void *b)
{
    const struct colmap_point *p = a, *q = b;
    const bool here = colmap_point_is_somewhere(p);
    if (here != colmap_point_is_somewhere(q)) /* those without a place last */
        return here ? -1 : 1;
    return (p->id > q->id) - (p->id < q->id);
}

static int colmap_name_compare(const void *a, const void *b)
{
    const struct colmap_image *const *p = a, *const *q = b;
    return strcmp((*p)->name, (*q)->name);
}

static enum err_code colmap_sort_and_check_unique(struct colmap_model *m, struct err *e)
{
    qsort(m->cameras, m->n_cameras, sizeof *m->cameras, colmap_camera_compare);
    qsort(m->images, m->n_images, sizeof *m->images, colmap_image_compare);
    qsort(m->points, m->n_points, sizeof *m->points, colmap_point_compare);
    for (size_t i = 1; i < m->n_cameras; i++)
        if (m->cameras[i].id == m->cameras[i - 1].id)
            return err_set(e, ERR_FORMAT, "cameras: id %u appears twice", m->cameras[i].id);
    for (size_t i = 1; i < m->n_images; i++)
        if (m->images[i].id == m->images[i - 1].id)
            return err_set(e, ERR_FORMAT, "images: id %u appears twice", m->images[i].id);
    for (size_t i = 1; i < m->n_points; i++)
        if (m->points[i].id == m->points[i - 1].id)
            return err_set(e, ERR_FORMAT, "points3D: id %llu appears twice",
                           (unsigned long long)m->points[i].id);
    const struct colmap_image **by_name = mem_array(m->n_images, sizeof *by_name);
    if (!by_name)
        return err_set(e, ERR_MEM, "out of memory for %zu images", m->n_images);
    for (size_t i = 0; i < m->n_images; i++)
        by_name[i] = &m->images[i];
    qsort(by_name, m->n_images, sizeof *by_name, colmap_name_compare);
    enum err_code rc = ERR_OK;
    for (size_t i = 1; i < m->n_images && !rc; i++)
        if (!strcmp(by_name[i]->name, by_name[i - 1]->name))
            rc = err_set(e, ERR_FORMAT, "images: '%.200s' appears twice", by_name[i]->name);
    mem_free(by_name);
    return rc;
}

/* Index of an id in a sorted array of records whose id is read by `id_at`; n when absent. */
static size_t colmap_find_id(const struct colmap_model *m, size_t n, uint64_t id,
                             uint64_t (*id_at)(const struct colmap_model *, size_t))
{
    size_t lo = 0, hi = n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (id_at(m, mid) < id)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo < n && id_at(m, lo) == id ? lo : n;
}

static uint64_t colmap_camera_id_at(const struct colmap_model *m, size_t i)
{
    return m->cameras[i].id;
}

static uint64_t colmap_image_id_at(const struct colmap_model *m, size_t i)
{
    return m->images[i].id;
}

static uint64_t colmap_point_id_at(const struct colmap_model *m, size_t i)
{
    return m->points[i].id;
}

static enum err_code colmap_camera_missing(const struct colmap_model *m, size_t n_foreign,
                                           const struct colmap_image *im, struct err *e)
{
    for (const struct colmap_camera *c = m->cameras + m->n_cameras; n_foreign-- > 0; c++)
        if (c->id == im->camera)
            return err_set(
                e, ERR_FORMAT, "images: '%.200s' is by camera %u, whose model %s is not read: %s",
                im->name, c->id, c->foreign,
                strcmp(c->foreign, "EQUIRECTANGULAR")
                    ? "make pictures without distortion by `colmap image_undistorter`, and give "
                      "these and their model"
                    : "cut the panoramas into pictures of a pinhole camera, and align these");
    return err_set(e, ERR_FORMAT,
                   "images: '%.200s' refers to camera %zu, which cameras does not hold", im->name,
                   im->camera);
}

/* Points without finite coordinates, *n of them behind the others, and their tracks. */
static enum err_code colmap_leave_out_points(struct colmap_model *m, size_t *n, struct err *e)
{
    size_t kept = 0, at = 0;
    for (*n = 0; m->n_points && !colmap_point_is_somewhere(&m->points[m->n_points - 1]);
         m->n_points--)
        ++*n;
    if (!*n)
        return ERR_OK;
    for (size_t i = 0; i < m->n_points; i++)
        kept += m->points[i].n_track;
    struct colmap_track_element *tracks = arena_get(&m->arena, kept, sizeof *tracks);
    if (!tracks)
        return err_set(e, ERR_MEM, "out of memory for %zu observations", kept);
    for (size_t i = 0; i < m->n_points; i++) {
        struct colmap_point *p = &m->points[i];
        if (p->n_track)
            memcpy(tracks + at, m->tracks + p->track, p->n_track * sizeof *tracks);
        p->track = at;
        at += p->n_track;
    }
    m->tracks = tracks;
    m->n_tracks = kept;
    log_warn("colmap", "%zu of %zu points are left out: their coordinates are not finite", *n,
             m->n_points + *n);
    return ERR_OK;
}

/* Cameras of a model that is not read are forgotten, unless a photograph is by one. */
static enum err_code colmap_resolve_images(struct colmap_model *m, struct err *e)
{
    size_t n_foreign = 0, n_left_out;
    enum err_code rc = colmap_leave_out_points(m, &n_left_out, e);
    if (rc)
        return rc;
    for (; m->n_cameras && m->cameras[m->n_cameras - 1].foreign; m->n_cameras--)
        n_foreign++;
    for (size_t i = 0; i < m->n_images; i++) {
        struct colmap_image *im = &m->images[i];
        size_t cam = colmap_find_id(m, m->n_cameras, im->camera, colmap_camera_id_at);
        if (cam == m->n_cameras)
            return colmap_camera_missing(m, n_foreign, im, e);
        im->camera = cam;
        for (size_t j = 0; j < im->n_obs; j++) {
            if (im->obs[j].point == -1)
                continue;
            const struct colmap_point key = {.id = (uint64_t)im->obs[j].point,
                                             .xyz = {(double)NAN, 0, 0}};
            size_t pt = colmap_find_id(m, m->n_points, key.id, colmap_point_id_at);
            if (pt == m->n_points && bsearch(&key, m->points + m->n_points, n_left_out, sizeof key,
                                             colmap_point_compare)) {
                im->obs[j].point = -1;
                continue;
            }
            if (pt == m->n_points)
                return err_set(e, ERR_FORMAT,
                               "images: '%.200s': observation %zu refers to point %lld, which "
                               "points3D does not hold",
                               im->name, j, (long long)im->obs[j].point);
            im->obs[j].point = (int64_t)pt;
        }
    }
    return ERR_OK;
}

static enum err_code colmap_resolve_track_images(struct colmap_model *m, struct err *e)
{
    for (size_t p = 0; p < m->n_points; p++)
        for (size_t k = 0; k < m->points[p].n_track; k++) {
            struct colmap_track_element *t = &m->tracks[m->points[p].track + k];
            size_t i = colmap_find_id(m, m->n_images, t->image, colmap_image_id_at);
            if (i == m->n_images)
                return err_set(
                    e, ERR_FORMAT,
                    "points3D: point %llu refers to image %u, which images does not hold",
                    (unsigned long long)m->points[p].id, t->image);
            t->image = (uint32_t)i;
        }
    return ERR_OK;
}

static enum err_code colmap_model_resolve(struct colmap_model *m, struct err *e)
{
    enum err_code rc = colmap_sort_and_check_unique(m, e);
    if (!rc)
        rc = colmap_resolve_images(m, e);
    if (!rc)
        rc = colmap_resolve_track_images(m, e);
    if (!rc)
        rc = colmap_tracks_agree(m, e);
    if (!rc)
        colmap_tracks_errors(m);
    return rc;
}

/* ---- files ---- */

enum layout { LAYOUT_NONE, LAYOUT_BIN, LAYOUT_TXT };
static const char *const suffixes[] = {"", ".bin", ".txt"};

/* Which complete set is in `dir`; `partial` (a file name) is filled with one that has no
 * companions. */
static enum layout colmap_model_in(const char *dir, char *partial, size_t n_partial)
{
    for (enum layout l = LAYOUT_BIN; l <= LAYOUT_TXT; l++) {
        int found = 0, missing = 0;
        for (int i = 0; i < PART_COUNT; i++) {
            char name[32], path[FILE_PATH_MAX];
            snprintf(name, sizeof name, "%s%s", part_names[i], suffixes[l]);
            if (file_join(path, dir, name, NULL) == ERR_OK && file_exists(path))
                found++;
            else
                missing = i;
        }
        if (found == PART_COUNT)
            return l;
        if (found && !partial[0])
            snprintf(partial, n_partial, "; %.300s has no %s%s", dir, part_names[missing],
                     suffixes[l]);
    }
    return LAYOUT_NONE;
}

/* Photographs of a model, without reading it whole: a number at the beginning of images.bin; in
 * images.txt every second line that is no comment. */
static size_t colmap_model_size(const char *dir, enum layout layout)
{
    char path[FILE_PATH_MAX];
    size_t n = 0;
    int c, line = 0;
    bool comment = false, begin = true;
    if (file_join(path, dir, layout == LAYOUT_BIN ? "images.bin" : "images.txt", NULL))
        return 0;
    FILE *f = fopen(path, "rb");
    if (!f)
        return 0;
    if (layout == LAYOUT_BIN) {
        uint8_t b[8];
        struct cursor k = cursor_over(b, fread(b, 1, sizeof b, f));
        n = (size_t)cursor_u64(&k);
    }
    while (layout == LAYOUT_TXT && (c = fgetc(f)) != EOF) {
        if (begin)
            comment = c == '#';
        begin = c == '\n';
        if (begin && !comment)
            n += line++ % 2 == 0;
    }
    fclose(f);
    return n;
}

/* The largest of the models in dir/0, dir/1 ..., into out; *most 0: there is none. COLMAP begins
 * another one with photographs that it cannot join to the first, in no order of size. */
static enum err_code colmap_model_largest(const char *dir, char *out, enum layout *layout,
                                          struct colmap_model *m, char *partial, size_t n_partial,
                                          struct err *e)
{
    size_t most = 0;
    for (unsigned k = 0, gap = 0; gap < MODELS_GAP; k++) {
        char name[16], path[FILE_PATH_MAX];
        snprintf(name, sizeof name, "%u", k);
        enum err_code rc = file_join(path, dir, name, e);
        if (rc)
            return rc;
        enum layout l = colmap_model_in(path, partial, n_partial);
        gap = l == LAYOUT_NONE ? gap + 1 : 0;
        if (l == LAYOUT_NONE)
            continue;
        size_t n = colmap_model_size(path, l);
        bool larger = !m->n_models || n > most;
        m->n_models++;
        m->n_second = larger ? most : n > m->n_second ? n : m->n_second;
        if (!larger)
            continue;
        most = n;
        *layout = l;
        memcpy(out, path, strlen(path) + 1);
    }
    return ERR_OK;
}

static enum err_code colmap_model_find(const char *dir, char *out, enum layout *layout,
                                       struct colmap_model *m, struct err *e)
{
    static const char *const below[] = {".", "sparse"};
    char partial[400] = "", folder[FILE_PATH_MAX];
    *layout = LAYOUT_NONE;
    for (size_t i = 0; i < 2 * (sizeof below / sizeof *below); i++) {
        enum err_code rc = file_join(folder, dir, below[i % 2], e);
        if (!rc && i >= 2) /* first the folders themselves, then numbered ones in them */
            rc = colmap_model_largest(folder, out, layout, m, partial, sizeof partial, e);
        else if (!rc && (*layout = colmap_model_in(folder, partial, sizeof partial))) {
            memcpy(out, folder, strlen(folder) + 1);
            m->n_models = 1;
        }
        if (rc || *layout != LAYOUT_NONE)
            return rc;
    }
    return err_set(e, ERR_NOENT,
                   "%.300s: no COLMAP model: looked for cameras, images and points3D as .bin or "
                   ".txt there, in sparse/ and in sparse/0/, sparse/1/ ...%s",
                   dir, *partial ? partial : "; `citysplat align PHOTOS -o MODEL` makes one");
}

static enum err_code colmap_model_read_part(const char *dir, int part, enum layout layout,
                                            struct colmap_model *m, struct err *e)
{
    typedef enum err_code bin_fn(const struct buf *, struct colmap_model *, struct err *);
    typedef enum err_code txt_fn(struct buf *, struct colmap_model *, struct err *);
    static bin_fn *const bins[] = {colmap_bin_cameras, colmap_bin_images, colmap_bin_points};
    static txt_fn *const txts[] = {colmap_txt_cameras, colmap_txt_images, colmap_txt_points};
    char name[32], path[FILE_PATH_MAX];
    struct buf file = {0};
    snprintf(name, sizeof name, "%s%s", part_names[part], suffixes[layout]);
    enum err_code rc = file_join(path, dir, name, e);
    if (!rc)
        rc = file_read(path, (size_t)64 << 30, &file, e);
    if (!rc && layout == LAYOUT_TXT) {
        buf_u8(&file, 0);
        rc = buf_check(&file, e);
    }
    if (!rc)
        rc = layout == LAYOUT_BIN ? bins[part](&file, m, e) : txts[part](&file, m, e);
    buf_free(&file);
    return rc;
}

enum err_code colmap_read(const char *dir, struct colmap_model *out, struct err *e)
{
    char found[FILE_PATH_MAX];
    enum layout layout;
    struct colmap_model m = {0};
    enum err_code rc = colmap_model_find(dir, found, &layout, &m, e);
    if (rc)
        goto out;
    for (int i = 0; i < PART_COUNT && !rc; i++)
        rc = colmap_model_read_part(found, i, layout, &m, e);
    if (!rc)
        rc = colmap_model_resolve(&m, e);
    if (rc) {
        err_add(e, "COLMAP model in %.300s", found);
        goto out;
    }
    memcpy(m.dir, found, strlen(found) + 1);
    *out = m;
    m = (struct colmap_model){0};
out:
    colmap_free(&m);
    if (rc)
        *out = (struct colmap_model){0};
    return rc;
}
