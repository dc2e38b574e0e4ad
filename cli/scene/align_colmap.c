/* Calls of COLMAP: see align_work.h.
 *
 * Photographs get names without blanks (links in work/.photos), which lists of COLMAP cannot have;
 * models get the true ones back. COLMAP's database keeps what is done within a stage.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "cli/scene/align_run.h"
#include "cli/scene/align_work.h"

enum { ALIGN_ARGS = 48, ALIGN_PARTS = 64, ALIGN_PART_LEAST = 32, ALIGN_LENS_PHOTOS = 20 };

/* Arguments of one run of COLMAP; texts live in the arena. */
struct align_args {
    struct align *a;
    const char *argv[ALIGN_ARGS];
    size_t n;
};

static void align_begin(struct align *a, struct align_args *x, const char *command)
{
    *x = (struct align_args){.a = a, .argv = {a->o->colmap, command}, .n = 2};
}

static void align_text(struct align_args *x, const char *name, const char *value)
{
    if (x->n + 2 >= ALIGN_ARGS || !value) {
        x->n = ALIGN_ARGS; /* told by align_call */
        return;
    }
    x->argv[x->n++] = name;
    x->argv[x->n++] = value;
}

static void align_number(struct align_args *x, const char *name, long long value)
{
    align_text(x, name, arena_printf(&x->a->arena, "%lld", value));
}

static enum err_code align_call(struct align_args *x, const char *log, const char *what,
                                uint64_t total, uint64_t (*count)(void *user), void *user,
                                struct err *e)
{
    char below[64];
    snprintf(below, sizeof below, "logs/%s.log", log);
    const struct align_run r = {.argv = x->argv,
                                .log = align_path(x->a, below),
                                .what = what,
                                .total = total,
                                .count = count,
                                .user = user};
    if (x->n >= ALIGN_ARGS || !r.log)
        return align_no_memory(e);
    return align_run(&r, e);
}

/* Text of a file that COLMAP wrote, as far as 64 KiB. */
static bool align_log_has(const char *path, const char *word, char *line, size_t room)
{
    struct buf b = {0};
    bool found = false;
    if (path && !file_read(path, 0, &b, NULL)) {
        buf_u8(&b, 0);
        const char *at = buf_check(&b, NULL) ? NULL : strstr((const char *)b.data, word);
        found = at != NULL;
        if (found && line)
            snprintf(line, room, "%.*s", (int)strcspn(at, "\r\n"), at);
    }
    buf_free(&b);
    return found;
}

enum err_code align_ask_version(struct align *a, struct err *e)
{
    struct align_args x;
    char *log = align_path(a, "logs/version.log");
    if (log)
        remove(log);
    align_begin(a, &x, "help");
    enum err_code rc = align_call(&x, "version", NULL, 0, NULL, NULL, e);
    if (!rc)
        align_begin(a, &x, "feature_extractor");
    if (!rc) {
        x.argv[x.n++] = "-h";
        rc = align_call(&x, "version", NULL, 0, NULL, NULL, e);
    }
    if (!rc && !align_log_has(log, "COLMAP ", a->version, sizeof a->version))
        rc = err_set(e, ERR_DATA, "%s: does not call itself COLMAP; see %s", a->o->colmap, log);
    a->renamed = !rc && align_log_has(log, "--FeatureExtraction.use_gpu", NULL, 0);
    a->has_prior = !rc && align_log_has(log, "pose_prior_mapper", NULL, 0);
    a->has_global = !rc && align_log_has(log, "global_mapper", NULL, 0);
    return rc;
}

/* Without blanks and other letters that lists of COLMAP cannot have. */
enum err_code align_link_photos(struct align *a, struct err *e)
{
    char *folder = align_path(a, "work/.photos"), root[FILE_PATH_MAX], target[FILE_PATH_MAX];
    if (!folder)
        return align_no_memory(e);
    enum err_code rc = file_mkdir(folder, e);
    if (!rc && !realpath(a->photos, root))
        rc = err_errno(e, ERR_IO, "%s", a->photos);
    for (size_t i = 0; !rc && i < a->plan.n; i++) {
        const struct align_photo *p = &a->plan.photos[i];
        char *link = arena_printf(&a->arena, "%s/%s", folder, p->link);
        if (!align_plan_usable(p))
            continue;
        rc = link ? file_join(target, root, p->name, e) : align_no_memory(e);
        if (!rc && access(link, F_OK) && (unlink(link), symlink(target, link)))
            rc = err_errno(e, ERR_IO, "%s: cannot link", link);
    }
    return rc;
}

static enum err_code align_write_text(struct align *a, const char *below, const struct buf *b,
                                      char **path, struct err *e)
{
    *path = align_path(a, below);
    enum err_code rc = *path ? buf_check(b, e) : align_no_memory(e);
    return rc ? rc : file_write(*path, b->data, b->size, e);
}

static uint64_t align_count_features(void *user)
{
    return align_db_count(user, "keypoints");
}

/* A camera for each group: COLMAP gives one to all that one run extracts. */
static enum err_code align_extract_group(struct align *a, size_t group, char *db, uint32_t edge_px,
                                         long long features, const char *log, const char *what,
                                         struct err *e)
{
    static const char *const lenses[] = {NULL, "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PINHOLE"};
    struct align_args x;
    struct buf b = {0};
    char below[64], *list;
    long long camera;
    size_t n = 0;
    for (size_t i = 0; i < a->plan.n; i++)
        if (align_plan_usable(&a->plan.photos[i]) && a->plan.photos[i].group == group) {
            buf_printf(&b, "%s\n", a->plan.photos[i].link);
            n++;
        }
    snprintf(below, sizeof below, "work/lens%zu.txt", group + 1);
    enum err_code rc = align_write_text(a, below, &b, &list, e);
    buf_free(&b);
    if (rc)
        return rc;
    const char *lens = lenses[a->o->lens]      ? lenses[a->o->lens]
                       : n < ALIGN_LENS_PHOTOS ? "SIMPLE_RADIAL"
                                               : "OPENCV";
    align_begin(a, &x, "feature_extractor");
    align_text(&x, "--database_path", db);
    align_text(&x, "--image_path", align_path(a, "work/.photos"));
    align_text(&x, "--image_list_path", list);
    align_text(&x, "--ImageReader.single_camera", "1");
    align_text(&x, "--ImageReader.camera_model", lens);
    if ((camera = align_db_camera(db, &a->plan, group)) >= 0) /* of a run that was killed */
        align_number(&x, "--ImageReader.existing_camera_id", camera);
    align_text(&x, a->renamed ? "--FeatureExtraction.use_gpu" : "--SiftExtraction.use_gpu", "0");
    align_number(
        &x, a->renamed ? "--FeatureExtraction.max_image_size" : "--SiftExtraction.max_image_size",
        edge_px);
    align_number(&x, "--SiftExtraction.max_num_features", features);
    align_number(&x,
                 a->renamed ? "--FeatureExtraction.num_threads" : "--SiftExtraction.num_threads",
                 (long long)align_cores(a));
    return align_call(&x, log, what, a->plan.n_usable, align_count_features, db, e);
}

enum err_code align_extract(struct align *a, char *db, uint32_t edge_px, long long features,
                            const char *log, const char *what, struct err *e)
{
    enum err_code rc = db ? ERR_OK : align_no_memory(e);
    for (size_t g = 0; !rc && g < a->plan.n_groups; g++)
        rc = align_extract_group(a, g, db, edge_px, features, log, what, e);
    return rc;
}

/* COLMAP commits the pairs of a run at its end: so they go in parts, and a run that was killed
 * loses one part. Pairs that the database has are skipped. */
static enum err_code align_match_part(struct align *a, char *db, size_t from, size_t to,
                                      const char *log, struct progress *p, struct err *e)
{
    struct align_args x;
    struct buf b = {0};
    char *list;
    for (size_t k = from; k < to; k++)
        buf_printf(&b, "%s %s\n", a->plan.photos[a->plan.pairs[k].a].link,
                   a->plan.photos[a->plan.pairs[k].b].link);
    enum err_code rc = align_write_text(a, "work/pairs.txt", &b, &list, e);
    buf_free(&b);
    if (rc)
        return rc;
    align_begin(a, &x, "matches_importer");
    align_text(&x, "--database_path", db);
    align_text(&x, "--match_list_path", list);
    align_text(&x, "--match_type", "pairs");
    align_text(&x, a->renamed ? "--FeatureMatching.use_gpu" : "--SiftMatching.use_gpu", "0");
    align_number(&x, a->renamed ? "--FeatureMatching.num_threads" : "--SiftMatching.num_threads",
                 (long long)align_cores(a));
    rc = align_call(&x, log, NULL, 0, NULL, NULL, e);
    progress_step(p, to, NULL);
    return rc;
}

enum err_code align_match(struct align *a, char *db, const char *log, const char *what,
                          struct err *e)
{
    struct progress p;
    size_t n = a->plan.n_pairs, part = n / ALIGN_PARTS + ALIGN_PART_LEAST;
    enum err_code rc = db ? ERR_OK : align_no_memory(e);
    progress_start(&p, what, n);
    for (size_t from = 0; !rc && from < n; from += part)
        rc = align_match_part(a, db, from, from + part < n ? from + part : n, log, &p, e);
    progress_end(&p, NULL);
    return rc;
}

/* ---- the model ---- */

static uint64_t align_count_placed(void *user)
{
    struct buf b = {0};
    uint64_t n = 0;
    if (!file_read(user, 0, &b, NULL)) {
        buf_u8(&b, 0);
        const char *at =
            buf_check(&b, NULL) ? NULL : strstr((const char *)b.data, "Registering image");
        for (; at; at = strstr(at + 1, "Registering image"))
            n++;
    }
    buf_free(&b);
    return n;
}

enum { ALIGN_AUTO, ALIGN_INCREMENTAL, ALIGN_PRIOR, ALIGN_GLOBAL }; /* option mapper */
static const char *const mapper_names[] = {NULL, "incremental", "prior", "global"};
static const char glomap[] = "glomap";
static const double height_sigmas = 3; /* of GPS in plan; receivers know heights so much worse */

static bool align_gps_will_do(const struct align *a)
{
    return a->plan.n_gps >= 3 && 2 * a->plan.n_gps >= a->plan.n_usable;
}

enum err_code align_check_mapper(struct align *a, struct err *e)
{
    if (a->o->mapper == ALIGN_PRIOR && !a->has_prior)
        return err_set(e, ERR_ARG,
                       "--mapper prior: %.100s has no pose_prior_mapper, which came with 3.11; "
                       "--mapper incremental does without, and ingest fits the model to GPS",
                       a->version);
    if (a->o->mapper == ALIGN_PRIOR && !align_gps_will_do(a))
        return err_set(e, ERR_ARG,
                       "--mapper prior: %zu of %zu photographs have GPS, half is needed",
                       a->plan.n_gps, a->plan.n_usable);
    if (a->o->mapper == ALIGN_GLOBAL && !a->has_global && align_run_find(glomap, NULL))
        return err_set(e, ERR_ARG,
                       "--mapper global: %.100s has no global_mapper, and there is no program "
                       "glomap in PATH",
                       a->version);
    return ERR_OK;
}

/* A call of a mapper. `narrow`: the focal length stays within a factor of two of what it begins
 * with, EXIF's or 1.2 times the longer edge. */
struct align_mapping {
    int how;
    bool narrow;
    const char *db, *out;
    char *log;
};

static void align_mapper_args(struct align *a, const struct align_mapping *g, struct align_args *x)
{
    static const char *const axes[] = {"x", "y", "z"};
    static const char *const commands[] = {NULL, "mapper", "pose_prior_mapper", "global_mapper"};
    bool own = g->how == ALIGN_GLOBAL && !a->has_global;
    align_begin(a, x, own ? "mapper" : commands[g->how]);
    if (own)
        x->argv[0] = glomap;
    align_text(x, "--database_path", g->db);
    align_text(x, "--image_path", align_path(a, "work/.photos"));
    align_text(x, "--output_path", g->out);
    if (g->how == ALIGN_GLOBAL)
        return;
    align_number(x, "--Mapper.num_threads", (long long)align_cores(a));
    align_text(x, "--Mapper.min_model_size", "3");
    if (g->narrow) {
        align_text(x, "--Mapper.min_focal_length_ratio", "0.5");
        align_text(x, "--Mapper.max_focal_length_ratio", "2");
    }
    if (g->how != ALIGN_PRIOR)
        return;
    align_text(x, "--overwrite_priors_covariance", "1");
    align_text(x, "--use_robust_loss_on_prior_position", "1"); /* some positions are far off */
    for (size_t k = 0; k < 3; k++)
        align_text(x, arena_printf(&a->arena, "--prior_position_std_%s", axes[k]),
                   arena_printf(&a->arena, "%g", (k == 2 ? height_sigmas : 1) * a->o->gps_sigma_m));
}

static enum err_code align_map_by(struct align *a, const struct align_mapping *g, struct err *e)
{
    struct align_args x;
    align_remove(g->out); /* of a run that was killed */
    remove(g->log);       /* photographs are counted in it */
    enum err_code rc = file_mkdir(g->out, e);
    if (rc)
        return rc;
    align_mapper_args(a, g, &x);
    a->mapper = mapper_names[g->how];
    return align_call(&x, "model", "model", a->plan.n_usable, align_count_placed, g->log, e);
}

/* The model at `done`, made as `g` says, and once more with a narrow focal length if its own is far
 * off; the one with more observations stays. */
static enum err_code align_map_focal(struct align *a, struct align_mapping g, const char *below,
                                     const char *done, struct err *e)
{
    struct align_weight first, second = {0};
    if (rename(g.out, done))
        return err_errno(e, ERR_IO, "%s: cannot rename", g.out);
    enum err_code rc = align_weigh(a, g.db, below, &first, e);
    if (rc || first.focal_off == 0 || g.how == ALIGN_GLOBAL)
        return rc;
    log_warn(
        "align",
        "the focal length came out at %.2g times that of EXIF, or of a usual lens: the model is "
        "sought again within a factor of two",
        first.focal_off);
    g.narrow = true;
    rc = align_map_by(a, &g, e);
    if (!rc)
        rc = align_weigh(a, g.db, "work/sparse.part", &second, e);
    if (rc && rc != ERR_DATA)
        return rc;
    if (second.n_observations <= first.n_observations) {
        align_remove(g.out);
        log_warn("align",
                 "that gave no better one. If the lens is a usual one, photographs aslant, "
                 "or the focal length in their EXIF, would help");
        return ERR_OK;
    }
    align_remove(done);
    return rename(g.out, done) ? err_errno(e, ERR_IO, "%s: cannot rename", g.out) : ERR_OK;
}

enum err_code align_map(struct align *a, const char *db, const char *below, struct err *e)
{
    struct err why = {0};
    char *part = align_path(a, "work/sparse.part"), *done = align_path(a, below),
         *log = align_path(a, "logs/model.log");
    if (!part || !done || !log)
        return align_no_memory(e);
    align_remove(done);
    int how = a->o->mapper                           ? (int)a->o->mapper
              : a->has_prior && align_gps_will_do(a) ? ALIGN_PRIOR
                                                     : ALIGN_INCREMENTAL;
    bool may_fail = !a->o->mapper && how == ALIGN_PRIOR;
    struct align_mapping g = {.how = how, .db = db, .out = part, .log = log};
    enum err_code rc = align_map_by(a, &g, may_fail ? &why : e);
    if (may_fail && rc == ERR_DATA) {
        log_warn("align", "with GPS as prior there is no model (%s): it is sought without",
                 why.msg);
        g.how = ALIGN_INCREMENTAL;
        rc = align_map_by(a, &g, e);
    } else if (may_fail && rc && e) {
        *e = why;
    }
    if (!rc)
        rc = align_map_focal(a, g, below, done, e);
    if (!rc)
        json_object_set_new(a->state, "mapper", json_string(a->mapper));
    return rc;
}
