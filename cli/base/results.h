/* Whether trained results, or a store of them, are complete and belong to a scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_RESULTS_H
#define CLI_RESULTS_H

#include "core/err.h"

struct area;
struct geo_origin;
struct json_t;
struct scene;

/* Warns if the cell `id` in DIR/cells is not trained to its end, and says which levels are missing.
 * `module` is that of the log line, `dir` where the scene's results lie. */
void results_warn_unfinished(const char *module, const struct scene *s, const char *dir,
                             const char *id);
/* Compares the scene's origin with that in the head of the checkpoint at `path`. A head of an older
 * version has none, and is taken. ERR_DATA: they are more than 1 m apart. ERR_FORMAT. */
enum err_code results_check_origin(const struct scene *s, const char *path,
                                   const struct json_t *meta, struct err *e) ERR_USE;
/* Compares the scene's origin with that of the store at `path`. ERR_DATA: they are more than 1 m
 * apart, so the store cannot be drawn by the scene's cameras. ERR_ARG. */
enum err_code results_check_frame(const struct scene *s, const char *path,
                                  const struct geo_origin *origin, struct err *e) ERR_USE;
/* Compares the area of the store at `path` with where the scene's cameras and points are. ERR_DATA:
 * they have no ground in common. */
enum err_code results_check_store(const struct scene *s, const char *path, const struct area *a,
                                  struct err *e) ERR_USE;

#endif
