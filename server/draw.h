/* What the process that draws is asked, and how it answers: views, map tiles and questions about
 * the surface, of stores whose descriptors it is sent. It alone has the OpenCL device and the
 * Gaussians on it; see worker.h for the process itself and picture.h for who asks.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DRAW_H
#define SERVER_DRAW_H

#include "core/camera.h"
#include "lod/query.h"
#include "server/appearance_api.h"
#include "server/map_tile.h"
#include "server/worker.h"

enum { DRAW_SLOTS = 4 /* stores that it has open */ };

struct draw_hello {                                        /* told once */
    char device[128], geoid[64], geoid_dir[FILE_PATH_MAX]; /* as the options; geoid "": none */
    uint64_t view_cache_bytes, view_gaussians;
    int nice; /* of the thread that draws and of those that it starts */
    bool log_json;
};
struct draw_view {
    struct camera cam;
    enum format format;
    int quality; /* of JPEG and WebP */
    struct paint paint;
};
enum draw_kind { DRAW_VIEW, DRAW_MAP, DRAW_QUERY };
struct draw_request {
    enum draw_kind kind;
    uint32_t slot;    /* of the store that is drawn */
    uint32_t drop;    /* a bit a slot: close these first */
    bool opens;       /* a descriptor came along: what the slot holds from here on */
    bool antialiased; /* of the store */
    char name[128];   /* of the store, for messages */
    struct appearance_choice appearance;
    union {
        struct draw_view view;
        struct map_tile map;
        struct query query;
    };
};

/* hello: struct draw_hello; request: struct draw_request. */
extern const struct worker_service draw_service;
/* Answer until `citysplat serve` ends: worker_main. Returns the exit code. */
int draw_main(void);

#endif
