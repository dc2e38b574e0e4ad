/* citysplat render: one picture, of a tile store with its levels of detail or straight from a file
 * of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/base/splats.h"
#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "core/splat/appearance.h"
#include "core/splat/camera.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/store/store.h"
#include "render/render.h"

struct render_cli_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/render.def"
};

static const struct options_def render_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct render_cli_options, __VA_ARGS__)
#include "cli/tiles/render.def"
};

static const struct options_spec render_spec = {
    .command = "render",
    .usage =
        "citysplat render FILE -o PICTURE (--lon --lat --height-m ... | --camera FILE) [options]",
    .about = "Draws one picture of a tile store, or of a .ply, .spz, .glb, .splat or "
             "checkpoint. With --camera, positions of a store are east-north-up metres about "
             "its origin; other files keep their own axes.",
    .example = "citysplat render city.tiles --lon 8.6821 --lat 50.1095 --height-m 260 "
               "--heading-deg 10 --pitch-deg -30 -o view.jpg\n"
               "citysplat render bridge.ply --camera cam.json -o view.npy",
    .defs = render_defs,
    .n_defs = sizeof render_defs / sizeof *render_defs,
    .min_args = 1,
    .max_args = 1};

enum { RENDER_QUALITY = 92 }; /* of .jpg and .webp: no artefact of theirs is seen */

static enum err_code render_background(const char *text, float out[3], struct err *e)
{
    double v[3];
    bool good = number_list(text ? text : "", 3, v);
    for (size_t i = 0; good && i < 3; i++) {
        good = v[i] >= 0.0 && v[i] <= 1.0;
        out[i] = (float)v[i];
    }
    return good ? ERR_OK
                : err_set(
                      e, ERR_ARG,
                      "--background: '%s': three numbers from 0 to 1 are expected, e.g. 0.5,0.7,1",
                      text ? text : "");
}

static enum err_code render_camera(const struct render_cli_options *o,
                                   const struct geo_origin *origin, struct camera *cam,
                                   struct err *e)
{
    bool placed = o->lon && o->lat && o->height_m;
    if (!o->camera == !placed)
        return err_set(e, ERR_ARG, "give either --lon, --lat and --height-m, or --camera FILE");
    if (o->camera) {
        json_t *j = NULL;
        enum err_code rc = jsonc_read(o->camera, &j, e);
        if (!rc && camera_from_json(j, cam, e))
            rc = err_add(e, "%s", o->camera);
        json_decref(j);
        return rc;
    }
    if (!origin)
        return err_set(
            e, ERR_ARG,
            "this file has no place on Earth: use --camera, or `citysplat import` it first");
    struct geo_origin at;
    char text[128];
    snprintf(text, sizeof text, "%.40s,%.40s,%.40s", o->lon, o->lat, o->height_m);
    enum err_code rc = splats_place("--lon --lat --height-m", text, &at, e);
    const struct view_pose pose = {.lon_deg = at.lon_deg,
                                   .lat_deg = at.lat_deg,
                                   .h_m = at.h_m,
                                   .heading_deg = o->heading_deg,
                                   .pitch_deg = o->pitch_deg,
                                   .fov_y_deg = o->fov_deg};
    return rc ? rc
              : view_camera(origin, &pose, (uint32_t)o->width_px, (uint32_t)o->height_px, cam, e);
}

/* As the Gaussians were trained. */
static enum render_aa render_aa_of(bool antialiased)
{
    return antialiased ? RENDER_AA_2D : RENDER_AA_NONE;
}

static enum err_code render_write(const struct render_cli_options *o, const struct camera *cam,
                                  const float *rgb, struct err *e)
{
    const char *dot = strrchr(o->output, '.');
    size_t n = (size_t)cam->width_px * cam->height_px * 3;
    if (dot && !strcasecmp(dot, ".npy")) {
        const size_t shape[3] = {cam->height_px, cam->width_px, 3};
        return npy_write(o->output, rgb, 3, shape, e);
    }
    struct image img = {0};
    enum err_code rc = image_alloc(cam->width_px, cam->height_px, 3, &img, e);
    for (size_t i = 0; !rc && i < n; i++)
        img.px[i] = (uint8_t)(fminf(fmaxf(rgb[i], 0.0f), 1.0f) * 255.0f + 0.5f);
    if (!rc)
        rc = image_write(o->output, &img, RENDER_QUALITY, NULL, e);
    image_free(&img);
    return rc;
}

struct render_job {
    const struct render_cli_options *o;
    struct render *render;
    struct render_options ro;
    struct camera cam;
    float *rgb;
};

static enum err_code render_buffer(struct render_job *job, struct err *e)
{
    size_t pixels = (size_t)job->cam.width_px * job->cam.height_px;
    job->rgb = mem_array(pixels, 3 * sizeof *job->rgb);
    return job->rgb ? ERR_OK
                    : err_set(e, ERR_MEM, "out of memory for a picture of %zu pixels", pixels);
}

static enum err_code render_store(struct render_job *job, const char *path, struct err *e)
{
    const struct render_cli_options *o = job->o;
    struct view *v = NULL;
    struct view_stats st = {0};
    enum err_code rc = view_open(path, job->render, 0, &v, e);
    if (rc)
        return rc;
    const struct store_meta *m = store_info(view_store(v));
    const struct pick_options po = {.error_px = o->error_px, .no_lod = o->error_px <= 0.0};
    float image[APPEARANCE_IMAGE_MAX];
    if (o->appearance)
        rc = view_find_appearance(v, o->appearance, image, e);
    if (!rc && o->appearance)
        rc = view_set_appearance(v, image, e);
    if (!rc)
        rc = render_camera(o, &m->origin, &job->cam, e);
    job->ro.aa = render_aa_of(m->antialiased);
    job->ro.supersample = VIEW_SUPERSAMPLE_AUTO;
    if (!rc)
        rc = render_buffer(job, e);
    if (!rc)
        rc = view_render(v, &job->cam, &job->ro, &po, job->rgb, &st, e);
    if (!rc)
        rc = render_write(o, &job->cam, job->rgb, e);
    if (!rc)
        printf("%s: %u x %u, %zu tiles, %llu Gaussians, %u visible; pick %.2f ms, load %.1f ms, "
               "render %.1f ms\n",
               o->output, job->cam.width_px, job->cam.height_px, st.n_tiles,
               (unsigned long long)st.n_gaussians, render_last_stats(job->render)->visible,
               st.ms_pick, st.ms_load, st.ms_render);
    view_close(&v);
    return rc;
}

static enum err_code render_file(struct render_job *job, const char *path, struct err *e)
{
    const struct render_cli_options *o = job->o;
    struct splats s = {0};
    struct render_model m = {0};
    bool uploaded = false;
    enum err_code rc = splats_read(path, NULL, &s, e);
    if (rc)
        return rc;
    if (o->appearance)
        rc = err_set(e, ERR_ARG, "--appearance: %s has one appearance only; give a tile store",
                     path);
    if (!rc)
        rc = render_camera(o, s.info.has_origin ? &s.info.origin : NULL, &job->cam, e);
    job->ro.aa = render_aa_of(s.g.antialiased);
    job->ro.picture = true;
    if (!rc)
        rc = render_buffer(job, e);
    double t0 = clock_s();
    if (!rc) {
        rc = render_model_upload(job->render, &s.g, &m, e);
        uploaded = !rc;
    }
    double t1 = clock_s();
    if (!rc)
        rc = render_forward(job->render, &m, &job->cam, &job->ro, job->rgb, NULL, e);
    double t2 = clock_s();
    if (!rc)
        rc = render_write(o, &job->cam, job->rgb, e);
    if (!rc)
        printf("%s: %u x %u, %zu Gaussians, %u visible; load %.1f ms, render %.1f ms\n", o->output,
               job->cam.width_px, job->cam.height_px, s.g.n,
               render_last_stats(job->render)->visible, 1e3 * (t1 - t0), 1e3 * (t2 - t1));
    if (uploaded)
        render_model_free(&m);
    splats_free(&s);
    return rc;
}

static enum err_code render_run(const char *path, const struct render_cli_options *o, struct err *e)
{
    struct dev dev;
    struct render_job job = {.o = o, .ro = {.sh_degree = GAUSS_SH_DEGREE_MAX}};
    enum splats_kind kind;
    enum err_code rc = render_background(o->background, job.ro.background, e);
    if (!rc)
        rc = splats_kind(path, &kind, e);
    if (rc)
        return rc;
    rc = dev_open(o->device, &dev, e);
    if (rc)
        return rc;
    rc = render_open(&dev, &job.render, e);
    if (!rc)
        rc = kind == SPLATS_STORE ? render_store(&job, path, e) : render_file(&job, path, e);
    mem_free(job.rgb);
    render_close(&job.render);
    dev_close(&dev);
    return rc;
}

enum err_code cli_render(int argc, char **argv, struct err *e)
{
    struct render_cli_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&render_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = output_needed(o.output, o.overwrite, e);
    if (!rc && !args.done)
        rc = output_apart(o.output, args.arg[0], e);
    if (!rc && !args.done)
        rc = output_apart(o.output, o.camera, e);
    if (!rc && !args.done)
        rc = render_run(args.arg[0], &o, e);
    arena_free(&arena);
    return rc;
}
