/* The done-file and the lock of a cell's folder.
 *
 * done.json is written after everything else, by rename. If it exists, the cell is complete, even
 * if a job was killed between two files. It repeats key numbers of the levels, so a list of many
 * cells need not open their checkpoints. The lock is an advisory lock on a file that is never
 * removed. It ends with the process, however that ends.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/done.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <jansson.h>

#include "core/base.h"
#include "train/base/result.h"

enum { DONE_VERSION = 1 };

static enum err_code done_level_size(const char *dir, uint32_t level, double *bytes, struct err *e)
{
    char name[32], path[FILE_PATH_MAX];
    struct stat st;
    snprintf(name, sizeof name, "level%u.ckpt", level);
    enum err_code rc = file_join(path, dir, name, e);
    if (rc)
        return rc;
    if (stat(path, &st))
        return err_errno(e, errno == ENOENT ? ERR_FORMAT : ERR_IO, "%s", path);
    *bytes = (double)st.st_size;
    return ERR_OK;
}

enum err_code done_write(const char *cell_dir, const struct train_cell_result *r, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *levels = json_array();
    json_t *root =
        json_pack("{s:i, s:s, s:s, s:f, s:o}", "done_version", DONE_VERSION, "cell", r->id,
                  "version", CITYSPLAT_VERSION, "seconds", r->seconds, "levels", levels);
    if (root && json_object_set_new(root, "timing", timing_json(&r->timing))) {
        json_decref(root);
        root = NULL;
    }
    enum err_code rc = file_join(path, cell_dir, "done.json", e);
    for (uint32_t i = 0; !rc && root && i < r->n_levels; i++) {
        double bytes = 0.0;
        rc = done_level_size(cell_dir, i + 1, &bytes, e);
        if (!rc && json_array_append_new(levels, json_pack("{s:I, s:o, s:o, s:I}", "gaussians",
                                                           (json_int_t)r->n_gaussians[i], "psnr_db",
                                                           jsonc_real(r->psnr_db[i]), "ssim",
                                                           jsonc_real(r->ssim[i]), "file_bytes",
                                                           (json_int_t)bytes)))
            rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    }
    if (!rc)
        rc = root ? jsonc_write(path, root, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    json_decref(root);
    return rc;
}

/* A score that was null is NaN again. */
static double done_score(const json_t *o, const char *key)
{
    const json_t *v = json_object_get(o, key);
    return json_is_number(v) ? json_number_value(v) : (double)NAN;
}

static enum err_code done_read_levels(const char *dir, const json_t *levels,
                                      struct train_cell_result *out, struct err *e)
{
    if (!json_array_size(levels) || json_array_size(levels) > TRAIN_LEVELS_MAX)
        return err_set(e, ERR_FORMAT, "\"levels\": 1 to %d are expected", TRAIN_LEVELS_MAX);
    out->n_levels = (uint32_t)json_array_size(levels);
    for (uint32_t i = 0; i < out->n_levels; i++) {
        const json_t *o = json_array_get(levels, i);
        double n, bytes, now = 0.0;
        enum err_code rc = jsonc_num(o, "gaussians", &n, e);
        if (!rc)
            rc = jsonc_num(o, "file_bytes", &bytes, e);
        if (!rc)
            rc = done_level_size(dir, i + 1, &now, e);
        if (rc)
            return rc;
        if (now != bytes || !(n >= 0.0))
            return err_set(e, ERR_FORMAT, "level%u.ckpt has %.0f bytes, %.0f were written", i + 1,
                           now, bytes);
        out->n_gaussians[i] = (size_t)n;
        out->psnr_db[i] = done_score(o, "psnr_db");
        out->ssim[i] = done_score(o, "ssim");
    }
    return ERR_OK;
}

enum err_code done_read(const char *cell_dir, struct train_cell_result *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *root = NULL;
    const char *id = NULL;
    double version = 0.0;
    *out = (struct train_cell_result){0};
    enum err_code rc = file_join(path, cell_dir, "done.json", e);
    if (!rc)
        rc = jsonc_read(path, &root, e);
    if (rc)
        return rc;
    rc = jsonc_num(root, "done_version", &version, e);
    if (!rc && version != DONE_VERSION)
        rc = err_set(e, ERR_FORMAT, "version %g, this program reads %d", version, DONE_VERSION);
    if (!rc)
        rc = jsonc_text(root, "cell", &id, e);
    if (!rc)
        rc = jsonc_num(root, "seconds", &out->seconds, e);
    if (!rc)
        rc = done_read_levels(cell_dir, json_object_get(root, "levels"), out, e);
    if (!rc)
        snprintf(out->id, sizeof out->id, "%s", id);
    if (!rc) /* files of older versions have none */
        timing_from_json(json_object_get(root, "timing"), &out->timing);
    json_decref(root);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

enum err_code done_lock(const char *cell_dir, int *fd, struct err *e)
{
    char path[FILE_PATH_MAX];
    *fd = -1;
    enum err_code rc = file_join(path, cell_dir, "lock", e);
    if (rc)
        return rc;
    *fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (*fd < 0)
        return err_errno(e, ERR_IO, "%s: cannot open", path);
    if (!flock(*fd, LOCK_EX | LOCK_NB)) {
        file_sweep_locked(cell_dir);
        return ERR_OK;
    }
    /* A file system without locks is no reason not to train. */
    if (errno != EWOULDBLOCK)
        return ERR_OK;
    done_unlock(fd);
    return err_set(e, ERR_BUSY,
                   "%s: another process trains this cell; wait for it or stop it, then start again",
                   cell_dir);
}

void done_unlock(int *fd)
{
    if (*fd >= 0)
        close(*fd);
    *fd = -1;
}
