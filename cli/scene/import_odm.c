/* citysplat import-odm: a project of OpenDroneMap or OpenSfM -> a COLMAP model, as align makes one.
 *
 * The frame of the project goes along as positions.tsv, places of the photographs on Earth, to
 * which `ingest --positions` fits the model again. See docs/decisions/005-poses.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "codec/scene/odm.h"
#include "core/outdir.h"

struct import_odm_options {
#define OPT OPTIONS_MEMBER
#include "cli/scene/import_odm.def"
};

static const struct options_def import_odm_defs[] = {
#define OPT(...) OPTIONS_ROW(struct import_odm_options, __VA_ARGS__)
#include "cli/scene/import_odm.def"
};

static const struct options_spec import_odm_spec = {
    .command = "import-odm",
    .usage = "citysplat import-odm PROJECT -o MODEL [options]",
    .about = "Makes a COLMAP model of a project of OpenDroneMap or OpenSfM, for `ingest`: lenses, "
             "poses and points of opensfm/reconstruction.json as they are, or the poses of "
             "odm_report/shots.geojson.",
    .example = "citysplat import-odm project -o model\n"
               "citysplat ingest project/images model --positions model/positions.tsv -o scene",
    .defs = import_odm_defs,
    .n_defs = sizeof import_odm_defs / sizeof *import_odm_defs,
    .min_args = 1,
    .max_args = 1};

static enum err_code import_odm_positions(const struct odm_project *p, const char *dir,
                                          struct err *e)
{
    struct buf b = {0};
    char path[FILE_PATH_MAX];
    buf_printf(&b, "image\tlongitude\tlatitude\taltitude\n");
    for (size_t i = 0; i < p->model.n_images; i++)
        if (p->places[i].known)
            buf_printf(&b, "%s\t%.12f\t%.12f\t%.6f\n", p->model.images[i].name,
                       p->places[i].lon_deg, p->places[i].lat_deg, p->places[i].h_m);
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = file_join(path, dir, "positions.tsv", e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

static const char *import_odm_links(const struct odm_project *p)
{
    static const char *const texts[] = {"tracks.csv", "computed", "none"};
    return texts[p->links];
}

static enum err_code import_odm_record(const struct odm_project *p, const char *dir, struct err *e)
{
    const struct colmap_model *m = &p->model;
    char path[FILE_PATH_MAX];
    json_t *o = json_pack("{s:s, s:s, s:I, s:I, s:I, s:I, s:s, s:I, s:I, s:I}", "citysplat",
                          CITYSPLAT_VERSION, "poses", p->from, "photographs",
                          (json_int_t)m->n_images, "cameras", (json_int_t)m->n_cameras, "points",
                          (json_int_t)m->n_points, "observations", (json_int_t)m->n_tracks,
                          "observations_by", import_odm_links(p), "points_left_out",
                          (json_int_t)p->n_alone, "photographs_of_smaller_reconstructions",
                          (json_int_t)p->n_others, "positions", (json_int_t)p->n_places);
    if (!o) /* a path that is not UTF-8 */
        return err_set(e, ERR_DATA, "%s: the path is not written in UTF-8; rename it", p->from);
    enum err_code rc = file_join(path, dir, "odm.json", e);
    if (!rc)
        rc = jsonc_write(path, o, e);
    json_decref(o);
    return rc;
}

static enum err_code import_odm_write(const struct odm_project *p, const char *dir, struct err *e)
{
    char sparse[FILE_PATH_MAX];
    enum err_code rc = file_join(sparse, dir, "sparse/0", e);
    if (!rc)
        rc = file_mkdir(sparse, e);
    if (!rc)
        rc = colmap_write_bin(sparse, &p->model, e);
    if (!rc && p->n_places)
        rc = import_odm_positions(p, dir, e);
    return rc ? rc : import_odm_record(p, dir, e);
}

static void import_odm_tell(const struct odm_project *p, const char *model)
{
    const struct colmap_model *m = &p->model;
    printf("%s: %zu photographs, %zu cameras, %zu points, %zu observations\n", p->from, m->n_images,
           m->n_cameras, m->n_points, m->n_tracks);
    if (p->n_others)
        log_warn("import-odm",
                 "%zu photographs belong to smaller reconstructions of the project and are left "
                 "out",
                 p->n_others);
    if (p->links == ODM_LINKS_COMPUTED)
        log_warn("import-odm",
                 "there is no tracks.csv beside the reconstruction: which photographs "
                 "see a point is computed");
    if (p->links == ODM_LINKS_NONE)
        log_warn("import-odm",
                 "there are no points: poses cannot be checked, and training begins without");
    if (p->n_places)
        printf("%s/positions.tsv: places of %zu photographs\n", model, p->n_places);
    else
        log_warn("import-odm", "the project does not say where on Earth it lies: ingest uses the "
                               "photographs' GPS, or --gcp");
    printf("next: citysplat ingest %s/images %s%s%s%s -o scene\n", p->project, model,
           p->n_places ? " --positions " : "", p->n_places ? model : "",
           p->n_places ? "/positions.tsv" : "");
}

static enum err_code import_odm_run(const char *project, const struct import_odm_options *o,
                                    struct err *e)
{
    struct odm_project p = {0};
    struct outdir dir = {0};
    enum err_code rc = outdir_begin(o->output, "odm.json", o->overwrite, &dir, e);
    if (!rc)
        rc = odm_read(project, &p, e);
    if (!rc)
        rc = import_odm_write(&p, dir.part, e);
    if (!rc)
        rc = outdir_commit(&dir, e);
    if (!rc)
        import_odm_tell(&p, o->output);
    outdir_abort(&dir);
    odm_free(&p);
    return rc;
}

enum err_code cli_import_odm(int argc, char **argv, struct err *e)
{
    struct import_odm_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&import_odm_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done && !o.output)
        rc = err_set(e, ERR_ARG, "-o MODEL is missing: the folder to make");
    if (!rc && !args.done) {
        signals_catch();
        rc = import_odm_run(args.arg[0], &o, e);
    }
    arena_free(&arena);
    return rc;
}
