/* citysplat-lab gradient: from dL/d(image) of one view to dL/d(parameters) of every Gaussian, as
 * .npy files.
 *
 * It is for users who combine this renderer with their own loss, and for comparisons with other
 * renderers. Gradients are of the raw parameters (before exp, sigmoid and normalisation), one row
 * for each vertex of the .ply. The five files appear together: they are written to a folder that is
 * renamed at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/limits.h"
#include "codec/splat/ply.h"
#include "core/device/dev.h"
#include "core/options/options.h"
#include "core/outdir.h"
#include "core/splat/camera.h"
#include "lab/lab.h"
#include "render/render.h"

#include <jansson.h>

struct gradient_options {
#define OPT OPTIONS_MEMBER
#include "lab/eval/gradient.def"
};

static const struct options_def gradient_defs[] = {
#define OPT(...) OPTIONS_ROW(struct gradient_options, __VA_ARGS__)
#include "lab/eval/gradient.def"
};

/* The files, and the planes of the device layout they hold. */
static const struct gradient_file {
    const char *name;
    uint32_t plane, width; /* width 0: all of SH */
} gradient_files[] = {{"mean.npy", LAYOUT_PLANE_MEAN, 3},
                      {"log_scale.npy", LAYOUT_PLANE_SCALE, 3},
                      {"quat_wxyz.npy", LAYOUT_PLANE_QUAT, 4},
                      {"opacity_logit.npy", LAYOUT_PLANE_OPACITY, 1},
                      {"sh.npy", LAYOUT_PLANE_SH, 0}};
enum { FILES = sizeof gradient_files / sizeof *gradient_files };

/* ---- input ---- */

static enum err_code gradient_parse_background(const char *text, float out[3], struct err *e)
{
    double v[3];
    if (!number_list(text ? text : "", 3, v))
        return err_set(e, ERR_ARG, "--background %s: expected three numbers, as in 0,0.5,1",
                       text ? text : "");
    for (size_t i = 0; i < 3; i++)
        out[i] = (float)v[i];
    return ERR_OK;
}

static enum err_code gradient_read_camera(const char *path, struct camera *out, struct err *e)
{
    struct json_t *json = NULL;
    enum err_code rc = jsonc_read(path, &json, e);
    if (!rc) {
        rc = camera_from_json(json, out, e);
        if (rc)
            err_add(e, "%s", path);
    }
    json_decref(json);
    return rc;
}

static enum err_code gradient_read_grad(const char *path, const struct camera *cam, float **out,
                                        struct err *e)
{
    size_t shape[3];
    enum err_code rc = npy_read(path, 3, shape, out, e);
    if (!rc && (shape[0] != cam->height_px || shape[1] != cam->width_px || shape[2] != 3))
        rc = err_set(e, ERR_DATA, "%s: shape [%zu, %zu, %zu]: the camera's picture is [%u, %u, 3]",
                     path, shape[0], shape[1], shape[2], cam->height_px, cam->width_px);
    return rc;
}

/* ---- the work ---- */

/* Raw gradients in the device layout; *out: mem_free. */
static enum err_code gradient_run(const char *device, const struct gauss *g,
                                  const struct camera *cam, const struct render_options *o,
                                  const float *rgb_grad, float **out, uint32_t *planes,
                                  struct err *e)
{
    struct dev dev = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    cl_mem grads = NULL;
    size_t words = 0;
    enum err_code rc = dev_open(device, &dev, e);
    if (!rc)
        rc = render_open(&dev, &r, e);
    if (!rc)
        rc = render_model_upload(r, g, &m, e);
    if (!rc)
        rc = render_forward(r, &m, cam, o, NULL, NULL, e);
    if (!rc)
        rc = render_set_color_grad(r, rgb_grad, e);
    words = (size_t)m.groups * m.planes * 16;
    if (!rc)
        rc = dev_buffer(&dev, words * sizeof(float), NULL, &grads, e);
    if (!rc)
        rc = render_backward(r, &m, grads, e);
    if (!rc) {
        *planes = m.planes;
        *out = mem_array(words, sizeof(float));
        rc = *out ? dev_read(&dev, grads, 0, words * sizeof(float), *out, e)
                  : err_set(e, ERR_MEM, "gradient: %zu Gaussians: out of memory", g->n);
    }
    dev_release(&grads);
    render_model_free(&m);
    render_close(&r);
    dev_close(&dev);
    return rc;
}

/* ---- output ---- */

static enum err_code gradient_write_file(const char *dir, const struct gradient_file *f,
                                         const float *raw, uint32_t planes, const struct gauss *g,
                                         struct err *e)
{
    char path[FILE_PATH_MAX];
    size_t n = g->n;
    uint32_t width = f->width ? f->width : (uint32_t)(3 * gauss_sh_count(g->sh_degree));
    const size_t shape_2[2] = {n, width}, shape_3[3] = {n, width / 3, 3};
    float *rows = mem_array(n, width * sizeof *rows);
    if (!rows)
        return err_set(e, ERR_MEM, "gradient: %s: out of memory", f->name);
    for (size_t i = 0; i < n; i++)
        for (uint32_t k = 0; k < width; k++)
            rows[i * width + k] = raw[(i / 16 * planes + f->plane + k) * 16 + i % 16];
    enum err_code rc = file_join(path, dir, f->name, e);
    if (!rc && !f->width)
        rc = npy_write(path, rows, 3, shape_3, e);
    else if (!rc)
        rc = npy_write(path, rows, width == 1 ? 1 : 2, shape_2, e);
    mem_free(rows);
    return rc;
}

/* ERR_ARG when `dir` holds something else than an earlier result of ours that may be replaced. */
static enum err_code gradient_check_output(const char *dir, bool overwrite, struct err *e)
{
    if (!file_exists(dir) && !file_is_dir(dir))
        return ERR_OK;
    DIR *d = opendir(dir);
    if (!d)
        return err_errno(e, ERR_IO, "gradient: output folder %s", dir);
    enum err_code rc = ERR_OK;
    for (const struct dirent *entry; !rc && (entry = readdir(d)) != NULL;) {
        bool none = !strcmp(entry->d_name, ".") || !strcmp(entry->d_name, ".."), ours = none;
        for (size_t i = 0; i < FILES; i++)
            ours = ours || !strcmp(entry->d_name, gradient_files[i].name);
        if (ours && !none && !overwrite)
            rc = err_set(e, ERR_ARG,
                         "output folder %s: holds gradients; choose another, or replace them with "
                         "--overwrite",
                         dir);
        else if (!ours)
            rc = err_set(e, ERR_ARG, "output folder %s: it holds %s: name a new or empty folder",
                         dir, entry->d_name);
    }
    closedir(d);
    return rc;
}

static enum err_code gradient_write_folder(const char *dir, const float *raw, uint32_t planes,
                                           const struct gauss *g, struct err *e)
{
    struct outdir out;
    enum err_code rc = outdir_begin(dir, gradient_files[0].name, true, &out, e);
    for (size_t i = 0; !rc && i < FILES; i++)
        rc = gradient_write_file(out.part, &gradient_files[i], raw, planes, g, e);
    if (!rc)
        rc = outdir_commit(&out, e);
    outdir_abort(&out);
    return rc;
}

enum err_code lab_gradient(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "gradient",
        .usage = "citysplat-lab gradient SCENE.ply --camera cam.json --grad dLdimage.npy -o DIR "
                 "[options]",
        .about =
            "Renders the Gaussians, reads dL/dimage and writes dL/dparameters: mean.npy [n,3], "
            "log_scale.npy [n,3], quat_wxyz.npy [n,4], opacity_logit.npy [n] and sh.npy "
            "[n,K,3]. Values are float32, with respect to the raw parameters. Rows are in the "
            "order of the file.",
        .example =
            "citysplat-lab gradient city.ply --camera cam.json --grad dl.npy -o grads --aa none",
        .defs = gradient_defs,
        .n_defs = sizeof gradient_defs / sizeof *gradient_defs,
        .min_args = 1,
        .max_args = 1};
    struct gradient_options o;
    struct options_args args;
    struct arena arena = {0};
    struct gauss g = {0};
    struct ply_info info;
    struct camera cam;
    const struct codec_limits limits = {0};
    float *rgb_grad = NULL, *raw = NULL;
    uint32_t planes = 0;
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    struct render_options ro = {.aa = (enum render_aa)o.aa, .sh_degree = (int)o.sh_degree};
    if (!o.camera || !o.grad || !o.output)
        rc = err_set(e, ERR_ARG, "%s is missing",
                     !o.camera ? "--camera FILE"
                     : !o.grad ? "--grad FILE"
                               : "-o DIR");
    if (!rc)
        rc = gradient_parse_background(o.background, ro.background, e);
    if (!rc)
        rc = gradient_check_output(o.output, o.overwrite, e);
    if (!rc)
        rc = gradient_read_camera(o.camera, &cam, e);
    if (!rc)
        rc = gradient_read_grad(o.grad, &cam, &rgb_grad, e);
    if (!rc)
        rc = ply_read(args.arg[0], &limits, &g, &info, e);
    if (!rc)
        rc = gradient_run(o.device, &g, &cam, &ro, rgb_grad, &raw, &planes, e);
    if (!rc)
        rc = gradient_write_folder(o.output, raw, planes, &g, e);
out:
    mem_free(rgb_grad);
    mem_free(raw);
    gauss_free(&g);
    arena_free(&arena);
    return rc;
}
