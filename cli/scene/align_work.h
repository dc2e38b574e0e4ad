/* What the parts of `citysplat align` share: the plan, the working folder, and the state of the
 * run.
 *
 *   DIR/sparse/0, 1 ...   models, the largest first
 *   DIR/align.json        how it was made: versions, options, seconds, photographs not placed
 *   DIR/logs/STAGE.log    the output of COLMAP
 *   DIR/work/             database, lists, links, state.json
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ALIGN_WORK_H
#define CLI_ALIGN_WORK_H

#include <jansson.h>

#include "cli/scene/align_db.h"
#include "core/options/options.h"
#include "scene/ingest/align_plan.h"
#include "scene/ingest/pose_error.h"

const struct options_spec *align_options(void);

struct align_options {
#define OPT OPTIONS_MEMBER
#include "cli/scene/align.def"
};

/* ALIGN_INLIERS: COLMAP's least number of inliers of a match */
enum { ALIGN_SHOWN = 20, ALIGN_INLIERS = 15 };
enum align_stage {
    ALIGN_LOOK,
    ALIGN_FEATURES,
    ALIGN_MATCHES,
    ALIGN_MODEL,
    ALIGN_AGAIN, /* of photographs that lack features; only where there are any */
    ALIGN_STAGES
};

struct align {
    const struct align_options *o;
    const char *photos, *dir;
    struct align_plan plan;
    struct align_forecast forecast;
    char version[128]; /* what COLMAP calls itself */
    /* COLMAP 3.12 or newer: options that are not SIFT's alone have other names */
    bool renamed;
    bool has_prior, has_global; /* commands of COLMAP: pose_prior_mapper, global_mapper */
    const char *mapper;         /* that made the model: incremental, prior or global */
    json_t *state;
    struct align_pace pace;  /* of this machine, measured by the look */
    struct align_seen *seen; /* [plan.n] */
    uint32_t *model_of;      /* [plan.n] model that has the photograph, UINT32_MAX: none */
    struct pose_error *pose; /* [plan.n] in the largest model */
    double *pose_most_px;    /* [plan.n] the most that pose.picture_px may be for ingest */
    size_t n_models, placed, n_good, *sizes;
    struct arena arena;
};

/* ---- align_state.c: the folder, and which stages are complete ---- */

static inline enum err_code align_no_memory(struct err *e)
{
    err_set(e, ERR_MEM, "align: out of memory");
    return ERR_MEM;
}
size_t align_cores(const struct align *a);
/* "DIR/below" in the arena; NULL: out of memory. */
char *align_path(struct align *a, const char *below);
/* Removes a file or folder, if there is one. */
void align_remove(const char *path);
const char *align_stage_name(enum align_stage s);
bool align_is_done(const struct align *a, enum align_stage s);
/* Takes up the state of an earlier run, or makes a new folder. ERR_ARG: the folder belongs to
 * something else, or to other photographs or options. ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code align_open(struct align *a, struct err *e) ERR_USE;
/* Writes state.json. ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code align_save(struct align *a, struct err *e) ERR_USE;
/* Times of a stage: by the clock, and of COLMAP's processors. */
struct align_spent {
    double clock_s, cpu_s;
};
struct align_spent align_spent_now(void);
/* Notes that a stage is complete, with the times since `start`. */
enum err_code align_set_done(struct align *a, enum align_stage s, const struct align_spent *start,
                             struct err *e) ERR_USE;
/* Writes the options that decide the result, as this run has them, into the state. */
void align_set_options(struct align *a);

/* ---- align_colmap.c: calls of COLMAP. Errors are those of align_run. ---- */

enum err_code align_ask_version(struct align *a, struct err *e) ERR_USE;
/* Makes links to the photographs, under names that COLMAP's lists can hold. */
enum err_code align_link_photos(struct align *a, struct err *e) ERR_USE;
/* Extracts the features of all photographs. `log` is the stage, `what` is for the progress bar. */
enum err_code align_extract(struct align *a, char *db, uint32_t edge_px, long long features,
                            const char *log, const char *what, struct err *e) ERR_USE;
/* Compares the pairs of the plan. */
enum err_code align_match(struct align *a, char *db, const char *log, const char *what,
                          struct err *e) ERR_USE;
/* Checks that the mapper that was asked for is there. ERR_ARG: it is not. */
enum err_code align_check_mapper(struct align *a, struct err *e) ERR_USE;
/* Computes the models, in the folder `below` of DIR. */
enum err_code align_map(struct align *a, const char *db, const char *below, struct err *e) ERR_USE;

/* ---- align_tell.c: what is printed, and align.json ---- */

void align_print_plan(const struct align *a);
void align_print_forecast(const struct align *a);
void align_print_look(const struct align *a, size_t largest);
/* Sum of a key of the state ("seconds", "processor_seconds") over all stages. */
double align_sum(const struct align *a, const char *key);
/* Prints the photographs outside the largest model, with the reason. */
void align_print_unplaced(const struct align *a);
void align_print_result(const struct align *a);
/* Writes align.json. It takes over the reference to `config`. ERR_DATA, ERR_IO, ERR_LIMIT, ERR_MEM.
 */
enum err_code align_write_result(struct align *a, json_t *config, struct err *e) ERR_USE;

/* ---- align_publish.c ---- */

/* Writes COLMAP's models, of the folder `below` of DIR, to DIR/sparse, the largest first, with the
 * true names of photographs, and judges the poses of the largest. ERR_DATA: there is no model.
 * ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code align_publish(struct align *a, const char *below, struct err *e) ERR_USE;

/* Of the largest model in the folder `below` of DIR. A plane that is seen straight on does not fix
 * the focal length, so photographs straight down of flat ground nearly fit cameras with a focal
 * length that is far too long. ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
struct align_weight {
    /* focal length, as a multiple of what COLMAP began with: EXIF's, or 1.2 times the longer edge;
     * 0: all cameras are within a factor of two */
    double focal_off;
    size_t n_observations;
};
enum err_code align_weigh(struct align *a, const char *db, const char *below,
                          struct align_weight *out, struct err *e) ERR_USE;

/* Is it in the largest model, with a pose that ingest keeps? */
bool align_is_good(const struct align *a, size_t i);

/* ---- align_again.c ---- */

/* Seeks more features for photographs that match others without finding a pose that ingest keeps,
 * as far as --minutes allows, and publishes the model if it is better. Errors are those of
 * align_run and align_publish. */
enum err_code align_again(struct align *a, struct err *e) ERR_USE;

#endif
