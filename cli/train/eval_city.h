/* Cities as they are scored: the trained levels of a scene, or its tile store, as sources of
 * drawings. `citysplat eval` scores them against photographs, citysplat-lab against other truths.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EVAL_CITY_H
#define CLI_EVAL_CITY_H

#include "codec/scene/scene.h"
#include "core/device/dev.h"
#include "core/options/options.h"
#include "lod/choose/pick.h"
#include "scene/cells/partition.h"
#include "train/model/appearance_train.h"
#include "train/photographs/evaluate.h"

struct eval_city_options {
#define OPT OPTIONS_MEMBER
#include "cli/train/eval_city.def"
};

struct eval_city { /* free with eval_city_close, also after an error */
    struct eval_city_options o;
    uint32_t supersample;    /* pixels drawn for one pixel on each axis */
    bool full_size;          /* every level at the size of the finest level */
    enum pick_metric metric; /* of a store, with the next */
    double distance_m[2];    /* of PICK_DISTANCE */
    size_t cache_bytes;      /* of the store on the device */
    struct scene scene;
    uint32_t *images; /* [n_images] photographs to score */
    size_t n_images;
    struct partition plan; /* n_cells 0: the scene is one cell */
    struct dev dev;
    bool dev_is_open;
    bool exposed; /* the scene knows exposures */
    struct render *render;
    struct appearance model; /* of what is drawn now; no block: none */
    struct appearance_view view;
};

/* One thing to score. All is borrowed from the call that gives it. */
struct eval_drawing {
    const char *what; /* "level 2", "tiles, LOD", "tiles, no LOD" */
    struct evaluate_source src;
    void *own_size; /* src.user for drawing without supersampling; NULL: src.user */
    void *above;    /* src.user for drawing orthographic views */
    /* Gives the Gaussians on the device for a camera, and options to draw them. The model is valid
     * until the next call. */
    enum err_code (*prepare)(void *user, const struct camera *cam,
                             const struct render_model **model, struct render_options *ro,
                             struct err *e);
    void *prepare_user;
    struct appearance_view *appearance; /* NULL: none */
    bool exposure;                      /* it was trained at the mean exposure */
    uint32_t max_edge_px;               /* of the photographs it is scored at, with the next */
    double downsample;
    bool all_photographs;    /* trained on with those that score it (--final-all) */
    double trained_steps;    /* over all cells; 0: not known */
    double gaussians, faint; /* share with an opacity below 0.5; both NAN: not known */
};
typedef enum err_code eval_city_fn(void *user, const struct eval_drawing *d, struct err *e);

/* Sets the members that have no option in `citysplat eval`. */
void eval_city_defaults(struct eval_city *c);
/* Opens a scene, its photographs of one split, and the device. `o` and the members of
 * eval_city_defaults are filled in before, the rest is zero. ERR_DATA: the scene keeps no such
 * photographs. Errors of scene_read, dev_open and render_open. */
enum err_code eval_city_open(struct eval_city *c, const char *scene_dir, enum scene_split split,
                             struct err *e) ERR_USE;
void eval_city_close(struct eval_city *c);

/* Opens the store of o.tiles, and gives the options to draw it and to pick its levels. Free *out
 * with view_close. Errors of view_open. */
struct view;
enum err_code eval_city_store(struct eval_city *c, struct view **out, struct render_options *ro,
                              struct pick_options *po, struct err *e) ERR_USE;

enum eval_city_which {
    EVAL_CITY_ALL,    /* all trained levels, coarsest first; a store with and without levels */
    EVAL_CITY_FINEST, /* the finest trained level; a store with and without levels */
    EVAL_CITY_ONE     /* the finest trained level; a store without levels */
};
/* Calls fn for what is drawn of a city: its store if o.tiles is given, else trained levels.
 * ERR_NOENT: nothing was trained. ERR_DATA: cells with different appearance models. Errors of fn
 * and of reading. */
enum err_code eval_city_each(struct eval_city *c, enum eval_city_which which, eval_city_fn *fn,
                             void *user, struct err *e) ERR_USE;

#endif
