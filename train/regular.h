/* Inside of train/: regularisers, terms of the loss that are not about the photograph's colours,
 * and the 3-D filter of Mip-Splatting. Equations, sources and measurements: docs/regularisers.md.
 *
 * Before a step's colours are drawn, regular_step puts what they say about mean, size, rotation and
 * opacity into one buffer that the fused backward pass adds to its gradients; densification
 * statistics never see it. Each part has kernels, and a reference in double for its test.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REGULAR_H
#define TRAIN_REGULAR_H

#include "render/render.h"

struct level;
struct feed_photo;
struct regular; /* of one level: buffers and compiled kernels, made on first use */

/* What the configuration asks for at this step; sets l->adam.extra_grad (NULL: nothing) and, with
 * Mip-Splatting, l->model.filter. Draws frames of its own: call before the step's render_forward.
 */
enum err_code regular_step(struct level *l, uint32_t step, const struct feed_photo *photo,
                           struct err *e) ERR_USE;
void regular_free(struct regular **r);
/* With Mip-Splatting: compute l->model.filter if it is not that of the Gaussians as they are. */
enum err_code regular_filter(struct level *l, struct err *e) ERR_USE;

/* ---- scale_loss.c: nothing larger than a building, no needles ---- */

/* With s the sigmas, r_i = max_k s_ik / (median_k s_ik + 1e-8):
 *   L = weight (sum_{s_ik > s_max} s_ik / (n + 1) + sum_{r_i > r_max} r_i / (m + 1)),
 * n and m the numbers of terms, held fixed. REUrbanGS (2025), section on regularisation. */
struct scale_loss_input {
    double s_max_m, r_max, weight;
};
struct scale_loss_value {
    double total;  /* weighted */
    uint32_t n, m; /* axes that are too long, needles */
};
struct scale_loss; /* compiled kernels */
enum err_code scale_loss_open(struct dev *dev, struct scale_loss **out, struct err *e) ERR_USE;
void scale_loss_close(struct scale_loss **s);
/* Enqueue: write dL/d(planes 0-10) into extra, float [groups][11][16], all of it; with sizes_only
 * dL/d(planes 3-5), [groups][3][16]. */
enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, bool sizes_only, cl_mem extra,
                             struct err *e) ERR_USE;
/* Wait and read the value of the last run. */
enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out,
                              struct err *e) ERR_USE;
/* In double; scale_log [n][3], grad [n][3] (may be NULL) is written. */
struct scale_loss_value scale_loss_ref_run(const double *scale_log, size_t n,
                                           const struct scale_loss_input *in, double *grad);

/* ---- mip.c: the 3-D filter of Mip-Splatting ---- */

struct mip; /* compiled kernels and the cameras */
enum err_code mip_open(struct dev *dev, struct mip **out, struct err *e) ERR_USE;
void mip_close(struct mip **m);
/* Compute model->filter (made when NULL) from the cameras: f_i = sqrt(0.2) min z / f_max, in m. */
enum err_code mip_run(struct mip *m, struct render_model *model, const struct camera *cams,
                      size_t n_cams, struct err *e) ERR_USE;
/* In double; f [g->n]. */
void mip_ref_filter(const struct gauss *g, const struct camera *cams, size_t n_cams, double *f);
/* Widen by the filter: scale_log and opacity_logit become those of what is drawn. */
void mip_fold(struct gauss *g, const float *filter);
void mip_fold_one(double f, double scale_log[3], double *opacity_logit);
/* Gradients of the folded parameters (in) to those of the raw ones (out), at the raw ones. */
void mip_fold_grad(double f, const double scale_log[3], double opacity_logit, double g_scale[3],
                   double *g_opacity);

/* ---- depth.c: pictures of inverse depth against what is known of it ---- */

#define DEPTH_HARD                                                                                 \
    0.9899 /* opacity of every Gaussian in the hard pass: just below the cut of alpha */

struct depth_input {
    const struct camera *cam;
    struct render_options options; /* of the colours; degree and background are not used */
    const float *target;           /* [h][w]: inverse depth times unit_m; below 0 = unknown */
    double unit_m;  /* 1 / median inverse depth: the loss is without unit, at any scale */
    size_t n_known; /* pixels over which the mean is taken */
    double weight;
    bool hard; /* every Gaussian with opacity o + stop_gradient(DEPTH_HARD - o) */
};
struct depth; /* compiled kernels, and a shadow of the model */
enum err_code depth_open(struct dev *dev, struct depth **out, struct err *e) ERR_USE;
void depth_close(struct depth **d);
/* Enqueue: L = weight / n_known sum |D - target| over the known pixels, D = sum alpha T unit / z,
 * its gradient added to extra, float [groups][11][16]. Draws a frame of r. */
enum err_code depth_run(struct depth *d, struct render *r, const struct render_model *m,
                        const struct depth_input *in, cl_mem extra, struct err *e) ERR_USE;
enum err_code depth_read(struct depth *d, double *loss,
                         struct err *e) ERR_USE; /* of the last run */
/* In double. depth [h][w] is D; out->sh is that of the shadow and of no use. */
enum err_code depth_ref_loss(const struct gauss *g, const struct depth_input *in, double *depth,
                             double *loss, struct err *e) ERR_USE;
enum err_code depth_ref_grads(const struct gauss *g, const struct depth_input *in,
                              const struct render_ref_grads *out, struct err *e) ERR_USE;

/* ---- depth_map.c: what is known of a photograph's depth ---- */

struct scene;
/* Why a map is not used; DEPTH_MAP_OK: it is. */
enum depth_verdict {
    DEPTH_MAP_OK,
    DEPTH_MAP_MISSING, /* no file of that name */
    DEPTH_MAP_FEW,     /* 10 good observations or fewer */
    DEPTH_MAP_FLAT,    /* the points' inverse depths, or the map at them, hardly differ */
    DEPTH_MAP_MISFIT,  /* falls where it should rise, or is off by a factor e^0.3 after alignment */
    DEPTH_MAP_SCALE,   /* aligned by another scale than the other photographs' maps */
    DEPTH_VERDICTS
};
extern const char *const depth_verdict_text[DEPTH_VERDICTS];
/* Align a map to inverse depths x of n points, y the map there: x ~ a y + b by mean absolute
 * deviations about medians, which outliers do not move far. */
enum depth_verdict depth_align(const double *x, const double *y, size_t n, double *a, double *b);

struct depth_map_config {
    const struct scene *scene; /* borrowed, as is images */
    const uint32_t *images;
    size_t n_images;
    const char *dir; /* NAME.npy, .png, .pfm or .tif of inverse depth, NAME with or without its own
                      * ending; NULL: none */
    bool sparse;     /* photographs without a map: the points that they observe */
};
struct depth_map; /* alignments of all maps, and the target of one photograph */
/* Reads every map once. ERR_DATA when not one can be used, with the reason; depth_map_close it. */
enum err_code depth_map_open(const struct depth_map_config *cfg, struct depth_map **out,
                             struct err *e) ERR_USE;
void depth_map_close(struct depth_map **d);
size_t depth_map_count(const struct depth_map *d, enum depth_verdict v);

struct depth_target {
    const float
        *t; /* [h][w] inverse depth times unit_m, below 0 = unknown; borrowed until the next */
    double unit_m;  /* 1 / median inverse depth */
    size_t n_known; /* over which the mean is taken; 0: nothing is known, t is NULL */
};
/* The target of a photograph seen by `cam`, that of the scene at any size. mask: [h][w], 0 =
 * nothing is known there; NULL: none. */
enum err_code depth_map_target(struct depth_map *d, uint32_t image, const struct camera *cam,
                               const uint8_t *mask, struct depth_target *out,
                               struct err *e) ERR_USE;

/* ---- similarity_loss.c: neighbours look alike ---- */

/* With i over `samples` Gaussians drawn at random (all when there are fewer), n_0 .. n_k-1 the k
 * nearest of i, itself included, in order of distance, and e^ = e / |e|:
 *   L = weight / (M C(k, 2)) sum_i sum_{a < b} w_ib (1 - e^_{n_a} . e^_{n_b}),
 *   w_ib = exp(-falloff |mu_i - mu_{n_b}|^2). */
struct similarity_loss_input {
    const float *mean_m; /* [n][3] */
    const float *embed;  /* not normalised: value c of row i is embed[i / 16 * embed_group + i % 16
                 * embed_lane + c * embed_next], as in a model or, 16 len, len, 1, [n][len] */
    size_t embed_group, embed_lane, embed_next;
    size_t n, len, samples, neighbours;
    double falloff, weight; /* 1 / m^2 */
    uint64_t seed, stream;
};
/* The loss now, the gradient in pieces that the caller has room for. Same input, same bits, on any
 * number of threads and with pieces of any size. The input is borrowed until similarity_loss_close,
 * which is due after an error as well. */
struct similarity_loss;
enum err_code similarity_loss_open(const struct similarity_loss_input *in,
                                   struct similarity_loss **out, double *loss,
                                   struct err *e) ERR_USE;
/* grad [count][len], written: dL/dembed of rows first .. first + count - 1. */
void similarity_loss_rows(const struct similarity_loss *w, size_t first, size_t count, float *grad);
void similarity_loss_close(struct similarity_loss **w);

/* ---- similarity_step.c: the same on a model in training ---- */

struct similarity_step; /* compiled kernels, and a buffer */
enum err_code similarity_step_open(struct dev *dev, struct similarity_step **out,
                                   struct err *e) ERR_USE;
void similarity_step_close(struct similarity_step **s);
/* Add the loss's gradient to Adam's moments of the embeddings, for the next render_backward_step to
 * take up; `like` without the fields of the model. Models without embeddings: nothing, loss 0. */
enum err_code similarity_step_run(struct similarity_step *s, const struct render_model *m,
                                  const struct render_adam *adam,
                                  const struct similarity_loss_input *like, double *loss,
                                  struct err *e) ERR_USE;

#endif
