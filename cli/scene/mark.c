/* citysplat mark: ground control points marked in photographs, by a page in a browser.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>
#include <sys/random.h>
#include <time.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/scene/control.h"
#include "cli/scene/mark_work.h"
#include "codec/scene/scene.h"
#include "scene/control/gcp_read.h"
#include "scene/ingest/ingest.h"
#include "server/base/config.h"
#include "server/http/static.h"
#include "survey/crs.h"

struct mark_options {
#define OPT OPTIONS_MEMBER
#include "cli/scene/mark.def"
};

static const struct options_def mark_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct mark_options, __VA_ARGS__)
#include "cli/scene/mark.def"
};

static const struct options_spec mark_spec = {
    .command = "mark",
    .usage = "citysplat mark SCENE [--points FILE] [-o gcp_list.txt] [options]\n"
             "citysplat mark PHOTOGRAPHS MODEL --points FILE [-o gcp_list.txt] [options]",
    .about = "Serves a page on which ground control points are marked in photographs, and prints "
             "its address. Every mark is saved at once. A scene knows its photographs, its model "
             "and its ground control. Without a scene PHOTOGRAPHS and MODEL are those of ingest. "
             "`ingest --gcp` reads the list. The command runs until it is interrupted.",
    .example = "citysplat mark scene --points points.csv\n"
               "citysplat mark photos/ photos/sparse/0 --points points.csv -o gcp_list.txt",
    .defs = mark_defs,
    .n_defs = sizeof mark_defs / sizeof *mark_defs,
    .min_args = 1,
    .max_args = 2};

/* ---- points and marks ---- */

/* Points and marks of `more` that `l` lacks, by their names. */
static enum err_code mark_merge(const char *path, struct gcp_list *l, struct gcp_list *more,
                                struct err *e)
{
    enum err_code rc = crs_split(&l->epsg, &l->heights_epsg, e);
    if (!rc)
        rc = crs_split(&more->epsg, &more->heights_epsg, e);
    if (!rc && l->epsg && more->epsg && l->epsg != more->epsg)
        rc = err_set(e, ERR_ARG, "%s: is in EPSG:%d, the list that is continued in EPSG:%d", path,
                     more->epsg, l->epsg);
    if (!rc && l->heights_epsg && more->heights_epsg && l->heights_epsg != more->heights_epsg)
        rc =
            err_set(e, ERR_ARG, "%s: has heights of EPSG:%d, the list that is continued of EPSG:%d",
                    path, more->heights_epsg, l->heights_epsg);
    l->epsg = l->epsg ? l->epsg : more->epsg;
    l->heights_epsg = l->heights_epsg ? l->heights_epsg : more->heights_epsg;
    for (size_t i = 0; !rc && i < more->n; i++)
        rc = gcp_add_point(path, l, &more->gcps[i], e);
    return rc;
}

static enum err_code mark_read_list(const struct mark_options *o, const struct mark_source *from,
                                    struct gcp_list *l, struct err *e)
{
    struct gcp_list more = {0};
    const bool there = file_exists(o->output);
    const char *points = o->points ? o->points : !there ? from->gcp : NULL;
    const char *first = there ? o->output : points;
    if (!first)
        return err_set(e, ERR_ARG,
                       "mark: which points? Give --points FILE, a CSV with columns name, x, y and "
                       "z, or a list to continue with -o");
    enum err_code rc = gcp_read_points(first, l, e);
    if (!rc && there && points) {
        rc = gcp_read_points(points, &more, e);
        if (!rc)
            rc = mark_merge(points, l, &more, e);
        gcp_free(&more);
    }
    if (!rc && !l->n)
        rc = err_set(e, ERR_DATA, "%s: no ground control points", first);
    const int epsg = o->gcp_epsg || o->points ? (int)o->gcp_epsg : from->gcp_epsg;
    return !rc ? control_unproject(first, epsg, l, e) : rc;
}

/* ---- photographs ---- */

/* The frame of a scene in place of GPS'. */
static enum err_code mark_take_frame(const char *dir, struct ingest_survey *survey, struct err *e)
{
    struct scene s;
    enum err_code rc = scene_read(dir, &s, e);
    if (rc)
        return rc;
    survey->placed = true;
    survey->origin = s.origin;
    survey->sim.scale = s.scale;
    memcpy(survey->sim.rot, s.rot, sizeof s.rot);
    memcpy(survey->sim.trans, s.trans, sizeof s.trans);
    scene_free(&s);
    return ERR_OK;
}

static enum err_code mark_look(const struct mark_options *o, const struct mark_source *from,
                               struct ingest_survey *survey, struct arena *a, struct err *e)
{
    struct ingest_config cfg;
    const char *scene = o->scene ? o->scene : from->scene;
    enum err_code rc = options_defaults(ingest_options(), &cfg, a, e);
    cfg.skip_missing = true;
    if (from->scene)
        cfg.max_reprojection_px = from->max_reprojection_px;
    if (!rc)
        rc = ingest_look(from->photographs, from->model, &cfg, survey, e);
    if (!rc && scene)
        rc = mark_take_frame(scene, survey, e);
    if (!rc && !survey->placed)
        log_warn("mark", "the photographs have too little GPS: points are expected in them only "
                         "when three points are marked in two photographs each; --scene SCENE "
                         "gives a frame");
    return rc;
}

/* ---- serving ---- */

static enum err_code mark_make_token(char out[MARK_TOKEN], struct err *e)
{
    uint8_t chance[(MARK_TOKEN - 1) / 2];
    if (getrandom(chance, sizeof chance, 0) != sizeof chance)
        return err_errno(e, ERR_IO, "the system has no random numbers");
    for (size_t i = 0; i < sizeof chance; i++)
        snprintf(out + 2 * i, 3, "%02x", chance[i]);
    return ERR_OK;
}

static enum err_code mark_check_page(struct err *e)
{
    char dir[FILE_PATH_MAX], page[FILE_PATH_MAX];
    bool found = static_default_dir(dir);
    if (found && !file_join(page, dir, "mark.html", e) && file_exists(page))
        return ERR_OK;
    return err_set(e, ERR_NOENT,
                   "the page's files are not %s: build web/ (npm ci && npm run build)",
                   found ? dir : "beside the program");
}

static enum err_code mark_serve(const struct mark_options *o, struct mark_work *w, struct arena *a,
                                struct err *e)
{
    struct server_config cfg;
    struct server *sv = NULL;
    const struct server_own own = {MARK_ROUTES, MARK_ROUTES_COUNT, w};
    enum err_code rc = config_defaults(&cfg, a, e);
    cfg.address = o->address;
    cfg.port = o->port;
    cfg.device = "none";
    cfg.access_log = false;
    cfg.workers = 1;
    cfg.http_threads = 4; /* photographs are read in them */
    if (!rc)
        rc = server_start_own(&cfg, &own, &sv, e);
    if (rc)
        return rc;
    printf("citysplat marks %zu points in %zu photographs: open %smark.html#%s\n",
           marking_list(w->marking)->n, marking_survey(w->marking)->n, server_url(sv), w->token);
    printf("every mark is saved to %s; Ctrl+C ends\n", w->output);
    fflush(stdout);
    while (!signals_stopping()) {
        const struct timespec wait = {.tv_nsec = 100000000};
        nanosleep(&wait, NULL);
        server_keep_memory(sv, clock_s());
    }
    return server_stop(&sv) ? ERR_OK : err_set(e, ERR_INTERNAL, "a thread does not end");
}

/* A list that a scene was made with has the scale that ingest was told. */
static double mark_scale(const struct mark_options *o, const struct mark_source *from)
{
    return from->gcp && !o->points && o->gcp_scale == 1 ? from->gcp_scale : o->gcp_scale;
}

enum err_code cli_mark(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct mark_options o;
    struct options_args args;
    struct gcp_list list = {0};
    struct ingest_survey survey = {0};
    struct mark_source from = {0};
    struct mark_work w = {.lock = PTHREAD_MUTEX_INITIALIZER,
                          .album = {.lock = PTHREAD_MUTEX_INITIALIZER}};
    enum err_code rc = options_parse(&mark_spec, argc, argv, &o, &args, &a, e);
    if (rc || args.done)
        goto out;
    rc = mark_scene_find(&args, &from, &a, e);
    if (rc)
        goto out;
    w.images_dir = from.photographs;
    w.output = o.output;
    signals_catch();
    rc = output_check(o.output, true, e); /* what is there is gone on with */
    if (!rc)
        rc = mark_check_page(e);
    if (!rc)
        rc = mark_read_list(&o, &from, &list, e);
    if (!rc)
        rc = mark_look(&o, &from, &survey, &a, e);
    if (!rc)
        rc = mark_make_token(w.token, e);
    if (!rc) {
        const struct marking_config cfg = {
            .output = o.output, .px_scale = mark_scale(&o, &from), .mark_px = 0.5, .sigma_m = 0.02};
        rc = marking_open(&cfg, &survey, &list, &w.marking, e);
    }
    if (!rc)
        rc = mark_serve(&o, &w, &a, e);
out:
    marking_close(&w.marking);
    mark_album_free(&w.album);
    ingest_survey_free(&survey);
    gcp_free(&list);
    arena_free(&a);
    return rc;
}
