/* A city of Gaussians into files, in parts: see synth_splats.h.
 *
 * A .ply has no name while it is written (O_TMPFILE), so that nothing is left of a process that is
 * killed. Its room is reserved before the first row is made. Threads make parts and write each at
 * its place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): O_TMPFILE, fallocate
#include <errno.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "codec/splat/ply.h"
#include "core/outdir.h"
#include "core/pool.h"
#include "lab/lab.h"
#include "lab/truth/synth_splats.h"

enum { SPLATS_PART_ROWS = 65536, SPLATS_LEVELS = 3 };
/* Where `citysplat synth` has its city. */
#define SPLATS_ORIGIN                                                                              \
    {                                                                                              \
        7.5733, 47.5584, 280                                                                       \
    }

struct splats_file {
    const struct synth_splats *city;
    const char *path;
    char part[FILE_PATH_MAX]; /* name before it is complete; "": it has none */
    int fd;
    struct ply_rows rows;
    struct buf head;
    atomic_size_t done;
    struct progress progress;
    atomic_flag busy;
};

/* ---- the .ply ---- */

static enum err_code write_part(void *user, size_t i, struct err *e)
{
    struct splats_file *f = user;
    struct gauss g = {0};
    size_t first = i * SPLATS_PART_ROWS, left = f->rows.n - first, row = ply_row_bytes(&f->rows);
    size_t n = left < SPLATS_PART_ROWS ? left : SPLATS_PART_ROWS;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    uint8_t *bytes = mem_uninit(n, row);
    enum err_code rc = bytes ? synth_splats_make(f->city, f->rows.n, first, n, true, &g, e)
                             : err_set(e, ERR_MEM, "splats: out of memory for %zu rows", n);
    if (!rc) {
        ply_encode_rows(&g, f->rows.doubles, bytes);
        rc = file_write_at(f->fd, f->path, bytes, n * row, f->head.size + (uint64_t)first * row, e);
    }
    gauss_free(&g);
    mem_free(bytes);
    size_t done = atomic_fetch_add(&f->done, n) + n;
    if (!atomic_flag_test_and_set(&f->busy)) {
        progress_step(&f->progress, done, NULL);
        atomic_flag_clear(&f->busy);
    }
    return rc;
}

/* A file without a name in the output's folder; with one where the file system has no such files.
 */
static enum err_code write_create(struct splats_file *f, struct err *e)
{
    char dir[FILE_PATH_MAX];
    enum err_code rc = file_begin(f->path, f->part, e);
    if (rc)
        return rc;
    snprintf(dir, sizeof dir, "%s", f->path);
    char *slash = strrchr(dir, '/');
    if (slash)
        slash[slash == dir] = '\0';
    f->fd = open(slash ? dir : ".", O_TMPFILE | O_RDWR | O_CLOEXEC, 0666);
    if (f->fd >= 0) {
        f->part[0] = '\0';
        return ERR_OK;
    }
    f->fd = open(f->part, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    return f->fd < 0 ? err_errno(e, ERR_IO, "%s: cannot create", f->path) : ERR_OK;
}

static enum err_code write_publish(struct splats_file *f, struct err *e)
{
    char own[64];
    if (fsync(f->fd))
        return err_errno(e, ERR_IO, "%s: cannot sync", f->path);
    if (!f->part[0]) {
        enum err_code rc = file_begin(f->path, f->part, e);
        snprintf(own, sizeof own, "/proc/self/fd/%d", f->fd);
        if (!rc && linkat(AT_FDCWD, own, AT_FDCWD, f->part, AT_SYMLINK_FOLLOW))
            rc = err_errno(e, ERR_IO, "%s: cannot give the file its name", f->path);
        if (rc)
            return rc;
    }
    return file_commit(f->part, f->path, e);
}

static enum err_code write_ply(const struct synth_splats_options *o,
                               const struct synth_splats *city, struct err *e)
{
    const struct ply_info info = {
        .has_origin = true, .origin = SPLATS_ORIGIN, .axes = PLY_AXES_ENU};
    struct splats_file f = {.city = city,
                            .path = o->output,
                            .fd = -1,
                            .rows = {.n = (size_t)o->count,
                                     .sh_degree = city->sh_degree,
                                     .doubles = city->reach_m > PLY_FLOAT_REACH_M},
                            .busy = ATOMIC_FLAG_INIT};
    size_t parts = (f.rows.n + SPLATS_PART_ROWS - 1) / SPLATS_PART_ROWS;
    ply_encode_head(&f.rows, &info, &f.head);
    uint64_t size = f.head.size + (uint64_t)f.rows.n * ply_row_bytes(&f.rows);
    enum err_code rc = buf_check(&f.head, e);
    if (!rc)
        rc = file_room(f.path, size, e);
    if (!rc)
        rc = write_create(&f, e);
    if (!rc && fallocate(f.fd, 0, 0, (off_t)size) && errno == ENOSPC)
        rc = err_errno(e, ERR_IO, "%s: no room for its %.1f GB", f.path, (double)size / 1e9);
    if (!rc)
        rc = file_write_at(f.fd, f.path, f.head.data, f.head.size, 0, e);
    if (!rc) {
        progress_start(&f.progress, "splats: Gaussians", f.rows.n);
        rc = pool_for(parts, 0, write_part, &f, e);
        progress_end(&f.progress, NULL);
    }
    if (!rc)
        rc = write_publish(&f, e);
    if (f.fd >= 0)
        close(f.fd);
    if (rc && f.part[0])
        file_abort(f.part);
    buf_free(&f.head);
    return rc;
}

/* ---- three levels, as training leaves them ---- */

struct splats_level {
    const struct synth_splats *city;
    size_t n;
    struct gauss window; /* rows that were made last */
    size_t first;
    bool coloured;
};

struct splats_make { /* a window, in pieces */
    struct splats_level *level;
    size_t piece_rows;
    struct gauss *piece;
};

static enum err_code write_make_piece(void *user, size_t i, struct err *e)
{
    struct splats_make *m = user;
    struct splats_level *l = m->level;
    size_t first = l->first + i * m->piece_rows, left = l->n - first;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    return synth_splats_make(l->city, l->n, first, left < m->piece_rows ? left : m->piece_rows,
                             l->coloured, &m->piece[i], e);
}

/* The window that begins with row `first`. */
static enum err_code write_window(struct splats_level *l, size_t first, bool colour, struct err *e)
{
    size_t n = l->n - first < 4 * SPLATS_PART_ROWS ? l->n - first : 4 * SPLATS_PART_ROWS;
    struct gauss piece[4] = {{0}};
    struct splats_make m = {l, SPLATS_PART_ROWS, piece};
    l->first = first;
    l->coloured = colour;
    gauss_free(&l->window);
    enum err_code rc = gauss_alloc(&l->window, n, l->city->sh_degree, 0, e);
    if (!rc)
        rc = pool_for((n + SPLATS_PART_ROWS - 1) / SPLATS_PART_ROWS, 0, write_make_piece, &m, e);
    for (size_t i = 0; i < 4; i++) {
        if (!rc)
            rc = gauss_append(&l->window, &piece[i], NULL, piece[i].n, e);
        gauss_free(&piece[i]);
    }
    return rc;
}

/* A checkpoint has one array after the other: the city is made once for each. Colours, which take
 * nearly all of the time, are made for one alone. */
static enum err_code write_level_rows(void *user, enum ckpt_field field, size_t first, size_t n,
                                      float *out, struct err *e)
{
    struct splats_level *l = user;
    const struct gauss *g = &l->window;
    enum err_code rc = ERR_OK;
    while (!rc && n > 0) {
        bool colour = field == CKPT_SH;
        if (first < l->first || first >= l->first + g->n || (colour && !l->coloured))
            rc = write_window(l, first, colour, e);
        if (rc)
            break;
        const float *const array[] = {g->mean_m, g->scale_log, g->quat_wxyz, g->opacity_logit,
                                      g->sh};
        const size_t wide[] = {3, 3, 4, 1, 3 * gauss_sh_count(g->sh_degree)};
        size_t at = first - l->first, here = g->n - at < n ? g->n - at : n;
        memcpy(out, array[field] + wide[field] * at, here * wide[field] * sizeof *out);
        out += here * wide[field];
        first += here;
        n -= here;
    }
    return rc;
}

static enum err_code write_level(const struct synth_splats *city, const char *dir, int level,
                                 size_t n, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct splats_level l = {.city = city, .n = n};
    const struct gauss like = {.n = n, .sh_degree = city->sh_degree};
    const struct ckpt_source from = {.like = &like, .rows = write_level_rows, .user = &l};
    json_t *meta = json_pack("{s:i, s:s}", "level", level, "made_by", "citysplat-lab splats");
    int len = snprintf(path, sizeof path, "%s/cells/all/level%d.ckpt", dir, level);
    enum err_code rc = len > 0 && (size_t)len < sizeof path
                           ? ERR_OK
                           : err_set(e, ERR_LIMIT, "%s: path too long", dir);
    if (!rc)
        rc = meta ? ckpt_write_from(path, meta, &from, NULL, 0, e)
                  : err_set(e, ERR_MEM, "splats: out of memory");
    gauss_free(&l.window);
    json_decref(meta);
    return rc;
}

static size_t write_level_count(const struct synth_splats_options *o, int level)
{
    size_t n = (size_t)o->count >> (SPLATS_LEVELS - level);
    return n ? n : 1;
}

static enum err_code write_dir(const struct synth_splats_options *o,
                               const struct synth_splats *city, struct err *e)
{
    struct outdir dir = {0};
    char cell[FILE_PATH_MAX];
    struct scene scene = {.origin = SPLATS_ORIGIN, .scale = 1, .rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    const struct ply_rows row = {.sh_degree = city->sh_degree};
    uint64_t bytes = 0;
    for (int level = 1; level <= SPLATS_LEVELS; level++) /* without the normals of a .ply */
        bytes += (uint64_t)write_level_count(o, level) * (ply_row_bytes(&row) - 12) + 65536;
    enum err_code rc = file_room(o->output, bytes, e);
    if (!rc)
        rc = outdir_begin(o->output, "scene.json", o->overwrite, &dir, e);
    if (rc)
        return rc;
    rc = scene_write(dir.part, &scene, e);
    if (!rc)
        rc = file_join(cell, dir.part, "cells/all", e);
    if (!rc)
        rc = file_mkdir(cell, e);
    for (int level = 1; !rc && level <= SPLATS_LEVELS; level++)
        rc = write_level(city, dir.part, level, write_level_count(o, level), e);
    if (!rc)
        rc = outdir_commit(&dir, e);
    outdir_abort(&dir);
    return rc;
}

enum err_code synth_splats_write(const struct synth_splats_options *o, struct err *e)
{
    struct synth_splats city;
    if (!o->output)
        return err_set(e, ERR_ARG, "splats: no output: give -o FILE.ply or -o DIR");
    const char *dot = strrchr(o->output, '.');
    bool ply = dot && !strcmp(dot, ".ply");
    if (ply && file_exists(o->output) && !o->overwrite)
        return err_set(e, ERR_ARG,
                       "%s: exists; choose another name, or replace it with --overwrite",
                       o->output);
    enum err_code rc = synth_splats_open((uint32_t)o->seed, (uint32_t)o->sh_degree,
                                         (size_t)o->count, o->spacing_m, &city, e);
    if (rc)
        return rc;
    log_info("synth", "city districts=%zu edges_m=%.0fx%.0f surfaces_km2=%.3f spacing_m=%.3f",
             city.n_districts, (double)city.columns * SYNTH_DISTRICT_M,
             (double)city.rows * SYNTH_DISTRICT_M, city.area_m2[city.n_districts] / 1e6,
             synth_splats_spacing(&city, (size_t)o->count));
    rc = ply ? write_ply(o, &city, e) : write_dir(o, &city, e);
    synth_splats_free(&city);
    return rc;
}

static const struct options_def splats_defs[] = {
#define OPT(...) OPTIONS_ROW(struct synth_splats_options, __VA_ARGS__)
#include "lab/truth/synth_splats.def"
};

enum err_code lab_synth_splats_write(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "splats",
        .usage = "citysplat-lab splats --count N -o FILE.ply|DIR [options]",
        .about = "Makes a procedural city of any size as Gaussians, without photographs and "
                 "training.",
        .example = "citysplat-lab splats --count 4M -o large.ply",
        .defs = splats_defs,
        .n_defs = sizeof splats_defs / sizeof *splats_defs};
    struct arena a = {0};
    struct synth_splats_options o;
    struct options_args args;
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &a, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    double start = clock_s();
    rc = synth_splats_write(&o, e);
    double took = clock_s() - start;
    if (!rc)
        printf("%s: %lld Gaussians in %.1f s (%.2f M/s)\n", o.output, (long long)o.count, took,
               (double)o.count / took / 1e6);
out:
    arena_free(&a);
    return rc;
}
