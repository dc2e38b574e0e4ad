/* Internal to train/: the terms of the loss, at a step. terms.def lists them, and terms.c runs them
 * in that order. docs/loss.md is made of the list.
 *
 * A new term is a row of PASS and a row of TERM in terms.def, a file train/terms/term_NAME.c with
 * its struct term_pass, and the option of its weight in options.def.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TERMS_H
#define TRAIN_TERMS_H

#include <stdbool.h>
#include <stdint.h>

#include "core/device/dev.h"
#include "core/err.h"

struct gallery;
struct model;
struct photo;
struct render_options;
struct site;
struct stage;
struct timing;

/* What a pass reads and where its gradient goes, in the order of a step. */
enum term_place {
    TERM_EMBEDDINGS, /* before the frame: the moments of Adam of the embeddings */
    TERM_GAUSSIANS,  /* before the frame: term_step.extra */
    TERM_PIXELS,     /* after the frame: the gradient of its colours */
    TERM_RAYS,       /* after the frame: the gradient of the sums along its rays */
    TERM_BACKWARD    /* in the backward pass: model->adam */
};

struct term_step { /* input of one step; all borrowed */
    struct gallery *gallery;
    const struct site *site;
    const struct stage *at;
    const struct photo *photo;
    const uint8_t *supported; /* [h][w] not 0: the photograph shows supported ground; NULL: no */
    struct render_options *frame; /* hand_over may set known depths in it */
    struct model *model;
    struct timing *timing;
    /* TERM_GAUSSIANS: float [groups][LAYOUT_PLANES_SHAPE][16], gradients of sizes and rotations of
     * model->seen. A pass adds to it; where it is fresh, it writes every value instead. */
    cl_mem extra;
    bool fresh;
};

struct term_pass {
    enum term_place place;
    /* Whether these options want it at any step. */
    bool (*wanted)(const struct gallery *gallery);
    /* Makes what it owns, once. NULL: it owns nothing. */
    enum err_code (*open)(const struct gallery *gallery, const struct site *site, void **own,
                          struct err *e);
    void (*close)(void *own); /* also half open */
    /* Whether it acts at this step. */
    bool (*acts)(const struct gallery *gallery, const struct stage *at);
    /* Before the frame of the step: hands over, without waiting, what it compares the frame with.
     * May be NULL. */
    enum err_code (*hand_over)(void *own, const struct term_step *s, struct err *e);
    enum err_code (*run)(void *own, const struct term_step *s, struct err *e);
};

/* The passes of terms.def, each in its file. */
#define PASS(name, place) extern const struct term_pass term_##name##_pass;
#include "train/terms/terms.def"

struct terms;
/* Opens the passes that the options want. *terms is NULL at first; if it is open already, nothing
 * is done. Free it with terms_free. ERR_DATA: no map of --depth-prior can be used. ERR_NOENT,
 * ERR_LIMIT, ERR_IO: of these maps. ERR_MEM, ERR_DEVICE. */
enum err_code terms_open(struct terms **terms, const struct gallery *gallery,
                         const struct site *site, struct err *e) ERR_USE;
void terms_free(struct terms **terms);
/* Whether any term acts in this place at this step. */
bool terms_act(const struct gallery *gallery, const struct stage *at, enum term_place place);
/* The unit of depth of a frame whose rays have terms, m: the height of the flight, or the edge of
 * the cell. */
double terms_depth_unit_m(const struct site *site);

/* The stages of a step. `supported` must stay as it is until render_forward returns. terms_before
 * sets model->adam.extra_grad (NULL: none). ERR_NOENT, ERR_FORMAT, ERR_IO: of a map of depth.
 * ERR_MEM, ERR_DEVICE. */
enum err_code terms_hand_over(struct terms *terms, const struct term_step *s,
                              struct err *e) ERR_USE;
enum err_code terms_before(struct terms *terms, const struct term_step *s, struct err *e) ERR_USE;
enum err_code terms_after(struct terms *terms, const struct term_step *s, struct err *e) ERR_USE;
enum err_code terms_backward(struct terms *terms, const struct term_step *s, struct err *e) ERR_USE;

enum { TERMS_MAX = 16 };
struct terms_list {
    const struct term_pass *const *pass;
    size_t n; /* at most TERMS_MAX */
};
/* As terms_open, with any list of passes, for tests. ERR_MEM, and what their `open` returns. */
enum err_code terms_open_list(struct terms **terms, const struct terms_list *list,
                              const struct gallery *gallery, const struct site *site,
                              struct err *e) ERR_USE;

#endif
