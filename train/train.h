/* Photographs in, Gaussians at three levels of detail out.
 *
 * Reading order: level.c is the loop (one step is a dozen lines); schedule.c says what happens at
 * which step; feed.c brings photographs; init.c, densify.c and score.c decide which Gaussians there
 * are; state.c saves and restores all of it; train.c strings levels together; evaluate.c scores the
 * result. The loss and the metrics have train/loss.h.
 *
 * One trajectory through the levels, level 1 the coarsest: each continues from the Gaussians of the
 * one before with its own budget, densification interval and picture size (Taming 3DGS, Mallick
 * 2024, for the budgets; 3D Gaussian Splatting, Kerbl 2023, for the rest). Files of a cell:
 *   cells/<id>/level<k>.ckpt   the result of level k: Gaussians, no optimiser state
 *   cells/<id>/resume.ckpt     everything, while the cell is unfinished
 *   cells/<id>/done.json       written last
 *   cells/<id>/metrics.jsonl, config.jsonc
 * Without a plan.json (train/partition.h) the scene is one cell, "all".
 *
 * Determinism: same seed, scene, options, device and build give the same bytes; a resumed run
 * equals the uninterrupted one. Every random number is rng_*(seed, stream, index); streams are
 * listed below.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TRAIN_H
#define TRAIN_TRAIN_H

#include "codec/codec.h"
#include "core/options.h"
#include "render/render.h"
#include "train/loss.h"
#include "train/partition.h"
#include "train/rows.h"
#include "train/spent.h"

enum { TRAIN_LEVELS_MAX = 3 };

struct train_config {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "train/options.def"
#undef OPT
};
/* The table behind struct train_config: flags, defaults, ranges, help. */
const struct options_spec *train_options(void);

/* Streams of the random numbers; level and step are mixed in by train_stream. */
enum train_stream_id {
    TRAIN_STREAM_SHUFFLE = 1,
    TRAIN_STREAM_INIT,
    TRAIN_STREAM_RACE,
    TRAIN_STREAM_SPLIT,
    TRAIN_STREAM_VIEWS,
    TRAIN_STREAM_SIMILARITY,
    TRAIN_STREAM_EMBED
};
uint64_t train_stream(enum train_stream_id id, uint32_t level, uint64_t step);

/* ---- schedule.c: what happens at which step ---- */

struct schedule {             /* of one level; steps are 1-based and restart at every level */
    uint32_t level, n_levels; /* 1 .. n_levels, 1 = coarsest */
    uint32_t steps;
    double downsample;
    size_t budget;
    uint32_t interval, densify_from,
        densify_until; /* densify when from < step < until and interval | step */
    uint32_t reset_interval;
    uint32_t sh_interval, sh_degree; /* sh_interval 0: the full degree from the start */
    bool absgrad;
    double tau;
    double lr_factor; /* on the learning rates of positions (included below), sizes and rotations */
    double lr_mean_first, lr_mean_last; /* metres */
    double
        kappa; /* factor on all lengths: photographs / 600 when more, or the share of a short run */
};
struct train_cell;
/* Fill out[0 .. level_count). ERR_ARG when a level would have no steps. */
enum err_code schedule_make(const struct train_config *cfg, size_t n_photos,
                            const struct train_cell *cell, struct schedule out[TRAIN_LEVELS_MAX],
                            struct err *e) ERR_USE;
/* Ceiling of Gaussians inside the cell at densification x of n: a parabola from start (x = 0) to
 * exactly budget (x = n - 1), fast first. start >= budget: start. n <= 1: budget. */
size_t schedule_cap(size_t start, size_t budget, uint32_t x, uint32_t n);
/* Number n of the above, counting x = 0, which no step uses. */
uint32_t schedule_densify_count(const struct schedule *s);
/* x of this step, or 0 when it does not densify. */
uint32_t schedule_densify_index(const struct schedule *s, uint32_t step);
bool schedule_resets(const struct schedule *s, uint32_t step);
/* Has an opacity reset happened at this level before `step`? */
bool schedule_was_reset(const struct schedule *s, uint32_t step);
uint32_t schedule_sh_degree(const struct schedule *s, uint32_t step);
double schedule_lr_mean(const struct schedule *s, uint32_t step);

/* ---- cell: what one training job covers ---- */

struct train_cell { /* a rectangle of the ground plane; Gaussians outside serve as background */
    char id[32];    /* folder name below cells/ */
    bool whole;     /* the whole scene: everything is inside, the rectangle is not used */
    double min_enu_m[2], max_enu_m[2]; /* east, north */
    double edge_m;   /* of an unmerged cell: unit of learning rates and of the distance ramp */
    double extent_m; /* 1.1 * largest distance of a camera from their mean: unit of sizes */
};
/* The single cell "all" of a scene. `images` lists the photographs used for training. */
void cell_whole(const struct scene *s, const uint32_t *images, size_t n_images,
                struct train_cell *out);
/* A cell of a plan; `images` lists its cameras by location, the measure of its extent. */
void cell_planned(const struct scene *s, const struct partition *p, size_t index,
                  const uint32_t *images, size_t n_images, struct train_cell *out);
/* Horizontal distance of a place from the rectangle, 0 inside. */
double cell_distance(const struct train_cell *c, double east_m, double north_m);

/* ---- feed.c: photographs, ahead of time ---- */

struct feed_photo {
    uint32_t image; /* index into the scene's images */
    struct camera cam;
    const uint8_t *px;   /* [h][w][3], borrowed until the next feed_get */
    const uint8_t *mask; /* [h][w], 0 = ignore; NULL: use all. From scene/masks (train/mask.h) */
    const char *name;    /* of the file, borrowed from the scene */
};
struct feed_config {
    const struct scene *scene; /* borrowed for the feed's lifetime, as is images */
    const uint32_t *images;
    size_t n_images;
    uint32_t max_edge_px; /* 0 = as ingested */
    double downsample;
    bool no_masks;      /* use photographs whole even where the scene has masks */
    size_t cache_bytes; /* decoded photographs kept; at least one is */
    uint64_t seed;
    uint32_t level;
};
struct feed; /* an LRU cache and one thread that decodes ahead of the order of use */
enum err_code feed_open(const struct feed_config *cfg, struct feed **out, struct err *e) ERR_USE;
void feed_close(struct feed **f);
/* The photograph of a step (1-based): position in this epoch's shuffle, a function of seed, level
 * and step. Waits until it is decoded and lets the thread go on with the ones after it. */
enum err_code feed_get(struct feed *f, uint32_t step, struct feed_photo *out,
                       struct err *e) ERR_USE;
/* The n-th of the list, out of order (scoring, evaluation); also borrowed until the next call. */
enum err_code feed_get_nth(struct feed *f, size_t nth, struct feed_photo *out,
                           struct err *e) ERR_USE;
size_t feed_bytes(const struct feed *f); /* held by the cache now */
/* The camera of a photograph at training size. */
struct camera feed_camera(const struct camera *cam, uint32_t max_edge_px, double downsample);

/* ---- init.c ---- */

/* Gaussians at the scene's points (for a cell of a plan: at those that its photographs see): size
 * from the three nearest neighbours, opacity 0.1. More points than `limit`: an even random choice.
 * None: 100 places in front of the cameras. Origin: mean of the points. gauss_free it. */
enum err_code init_gauss(const struct scene *s, const uint32_t *images, size_t n_images,
                         const struct train_cell *cell, uint32_t sh_degree, size_t limit,
                         uint64_t seed, struct gauss *out, struct err *e) ERR_USE;
/* How many points that would be without a limit. */
enum err_code init_count_points(const struct scene *s, const uint32_t *images, size_t n_images,
                                const struct train_cell *cell, size_t *out, struct err *e) ERR_USE;
/* dist2[i]: mean squared distance of point i to its three nearest others (fewer when there are
 * fewer). */
enum err_code init_neighbour_dist2(const float *xyz, size_t n, float *dist2, struct err *e) ERR_USE;

/* ---- densify.c: which Gaussians are added and removed ---- */

enum densify_kind { DENSIFY_KEEP, DENSIFY_CLONE, DENSIFY_SPLIT_A, DENSIFY_SPLIT_B };
struct densify_row {
    uint32_t source;
    enum densify_kind kind;
};
/* Where the two halves of a Gaussian go (order of --split):
 *   AXIS    at +-0.8 sigma on its longest axis, 0.6 sigma long: mean and covariance of the pair are
 *           those of the parent, and with 0.83 of its opacity so is the mass. The long-axis split
 * of Improved-GS (arXiv 2508.12313), with offsets from the moments. RANDOM  at two places drawn
 * from it, all axes 1.6 times shorter, opacity as it was (3DGS). */
enum densify_split { DENSIFY_SPLIT_AXIS, DENSIFY_SPLIT_RANDOM };
struct densify_params {
    const struct train_cell *cell;
    double origin_enu_m[3]; /* of the means in `params` */
    size_t cap_inside, cap_outside;
    double tau, tau_outside, split_above_m; /* larger ones are split */
    enum densify_split split;
    double prune_opacity, prune_above_m; /* 0 = no limit of size */
    uint64_t seed;
    uint32_t level, step;
};
struct densify_input { /* host copies in the device layout, [groups][planes][16] */
    const float *params;
    size_t n;
    uint32_t planes;
    const float *mean_grad; /* [n] mean positional gradient per frame seen, NDC units */
    const float *opacity; /* [n] what to compare with prune_opacity; NULL: that of the parameters */
    const float *score;   /* [n] importance, >= 0; NULL while the budget does not bind: all equal */
};
struct densify_report {
    size_t before, pruned, clone_candidates, split_candidates, room, cloned, split, after, inside,
        outside;
    bool needs_score; /* the budget binds: call again with a score */
};
struct densify_plan { /* {0} is empty; densify_plan_free */
    struct densify_row *rows;
    size_t n;
    struct densify_report report;
};
/* Choose. Without a score and with a binding budget only the report is filled (rows stays NULL).
 * Inside the cell there are never more than cap_inside afterwards, unless there were more before;
 * same outside. */
enum err_code densify_choose(const struct densify_params *p, const struct densify_input *in,
                             struct densify_plan *out, struct err *e) ERR_USE;
void densify_plan_free(struct densify_plan *p);
/* The rows of a plan along the Morton curve of their new means. */
struct densify_order { /* {0} is empty; densify_order_free */
    struct rows rows;  /* where each comes from; all but those kept are ROWS_NEW */
    uint32_t *split;   /* [n_split] rows that are halves ... */
    float *mean;       /* [n_split][3] ... and go there */
    size_t n_split;
    enum densify_split how;
};
enum err_code densify_order(const struct densify_params *p, const struct densify_input *in,
                            const struct densify_plan *plan, struct densify_order *out,
                            struct err *e) ERR_USE;
void densify_order_free(struct densify_order *o);
/* After rows_move of the parameters: copies of parents that were split become their halves. */
void densify_halve(const struct densify_order *o, float *params);
/* The k smallest of -ln(u_i) / score_i (exponential race = sampling without replacement): ids of
 * the chosen, in order of arrival. Scores of 0 come last. */
enum err_code densify_race(const float *score, const uint32_t *ids, size_t n, size_t k,
                           uint64_t seed, uint64_t stream, uint32_t *chosen, struct err *e) ERR_USE;

/* ---- record.c: one JSON object a line ---- */

struct record; /* an open metrics.jsonl */
enum err_code record_open(const char *path, bool append, struct record **out,
                          struct err *e) ERR_USE;
/* Add the line {"event": event, ...}; takes over the reference to `members` (may be NULL: out of
 * memory). */
enum err_code record_line(struct record *m, const char *event, struct json_t *members,
                          struct err *e) ERR_USE;
void record_close(struct record **m);

/* ---- train.c ---- */

struct train_cell_result {
    char id[32];
    bool was_done; /* --resume found it complete: the rest is not filled */
    uint32_t n_levels;
    size_t n_gaussians[TRAIN_LEVELS_MAX];
    double psnr_db[TRAIN_LEVELS_MAX],
        ssim[TRAIN_LEVELS_MAX]; /* test photographs at training size; NaN = none */
    double seconds;
    struct spent_times spent; /* of this process: what came before --resume is not in it */
};
struct train_result { /* {0} is empty; train_result_free */
    struct train_cell_result *cells;
    size_t n_cells;
    double seconds;
    size_t peak_bytes;
};
void train_result_free(struct train_result *r);
/* Do several cells with these options wait for an appearance model that they share
 * (train/shared.h)? cfg->appearance_only makes train_run train that and nothing else. */
bool train_needs_shared(const struct train_config *cfg);
/* Train the scene in `scene_dir`: the cells of its plan.json, or the one that cfg->cell names, or
 * all of it as one cell. ERR_CANCEL: stopped (signal or stop_after), the state was saved and the
 * message says how to go on. */
enum err_code train_run(const char *scene_dir, const struct train_config *cfg,
                        struct train_result *out, struct err *e) ERR_USE;
/* Indices of the photographs to train on (or, SCENE_TEST, to score), from the scene's arena. */
enum err_code train_images(struct scene *s, enum scene_split split, bool test_split, uint32_t **out,
                           size_t *n, struct err *e) ERR_USE;

/* ---- evaluate.c: how good it is ---- */

struct evaluate_score { /* means over the photographs */
    size_t n_photos;
    double psnr_db, ssim,
        ssim_valid;         /* ssim: zero padded as in the loss; ssim_valid: inner windows only */
    double l1, gmsd, lpips; /* lpips: 0 without weights */
    double gaussians;       /* handed to the renderer a frame */
    double visible;         /* of them in the picture; 0 when not told */
    double ms_frame;
    double bytes; /* what the source takes in files, 0 when not told */
};
struct lpips;         /* train/lpips.h */
struct residual_list; /* train/residual.h */
/* Something that draws: draw() renders into rgb [h][w][3] and says how many Gaussians it took. */
struct evaluate_source {
    enum err_code (*draw)(void *user, const struct camera *cam, float *rgb, double *gaussians,
                          struct err *e);
    void *user;
    const char *pictures; /* folder for NAME.png, photograph left and drawing right; NULL: none */
    double bytes;         /* of the source's files, handed through to the score */
    const struct render
        *render;         /* what draw() draws with: visible is asked of it; NULL: not told */
    struct lpips *lpips; /* NULL: no weights, not scored */
    struct residual_list *residuals; /* gets a row a photograph; NULL: none kept */
};
/* Add the scores of one photograph against its drawing to `sum` (PSNR, SSIM, L1), and make means of
 * `n` such sums. */
enum err_code evaluate_photo(const struct feed_photo *p, const float *rgb,
                             struct evaluate_score *sum, struct err *e) ERR_USE;
void evaluate_divide(struct evaluate_score *sum, double n);
/* Score every photograph of the feed's list. */
enum err_code evaluate_run(struct feed *f, size_t n_photos, const struct evaluate_source *src,
                           struct evaluate_score *out, struct err *e) ERR_USE;
/* A model on the device as a source; `user` is a struct evaluate_model. */
struct light_view;
struct evaluate_model {
    struct render *render;
    const struct render_model *model;
    struct render_options options;
    struct light_view *look; /* NULL: without appearance; else the nearest training cameras' look */
};
enum err_code evaluate_draw_model(void *user, const struct camera *cam, float *rgb,
                                  double *gaussians, struct err *e) ERR_USE;

#endif
