/* Requests to the process that draws, and its answers: views, map tiles and questions about the
 * surface. That process gets file descriptors of stores. It alone has the OpenCL device and
 * Gaussians on it. worker.h runs the process, picture.h sends the requests.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DRAW_H
#define SERVER_DRAW_H

#include "core/splat/camera.h"
#include "lod/surface/query.h"
#include "server/documents/appearance_api.h"
#include "server/drawing/map_tile.h"
#include "server/drawing/worker.h"

enum { DRAW_SLOTS = 4 /* number of stores that the process keeps open */ };
#define DRAW_PIXEL_MS 34e-6 /* time of a drawn pixel: docs/scale.md */

struct draw_hello {                         /* sent once, at the start */
    char device[128], geoid[FILE_PATH_MAX]; /* as in the options; geoid "": none */
    uint64_t view_cache_bytes, view_gaussians;
    uint64_t memory_bytes; /* beyond it, what is kept for the next picture is freed; 0: no limit */
    uint32_t slots;        /* stores to keep open, at most DRAW_SLOTS */
    int nice;              /* for the thread that draws and the threads that it starts */
    bool log_json;
};
struct draw_view {
    struct camera cam;
    enum format format;
    int quality; /* for JPEG and WebP */
    struct composite composite;
    bool planes; /* not encoded: in planes, for a video (codec/image/video.h) */
    bool moves;  /* of a moving camera: it may use the lists of the last one (view_render_moving) */
};
enum draw_kind { DRAW_VIEW, DRAW_MAP, DRAW_QUERY };
struct draw_request {
    enum draw_kind kind;
    uint32_t slot;    /* slot of the store to draw */
    uint32_t drop;    /* a bit for each slot to close first */
    bool opens;       /* a descriptor is attached: the slot holds that store from now on */
    bool antialiased; /* of the store */
    double lift_m;    /* of the store that is opened: store_lift */
    char name[128];   /* of the store, for messages */
    struct appearance_choice appearance;
    union {
        struct draw_view view;
        struct map_tile map;
        struct query query;
    };
};

/* What the process does for an answer, one after the other: worker_span. */
enum draw_stage {
    DRAW_OPENS,    /* a store */
    DRAW_PICKS,    /* tiles */
    DRAW_LOADS,    /* tiles, from the file to the device */
    DRAW_DRAWS,    /* Gaussians */
    DRAW_MEASURES, /* depth, and what is left behind the Gaussians */
    DRAW_ENCODES,
    DRAW_MAKES, /* a map tile or an answer, with all of these */
    DRAW_STAGES
};

/* hello is a struct draw_hello, request a struct draw_request. */
extern const struct worker_service draw_service;
/* Answers requests until `citysplat serve` ends: worker_main. Returns the exit code. */
int draw_main(void);

#endif
