/* The answers, a family a file: answer_<family>.c. Each fills a response, does not block and cannot
 * fail, since a failure is an answer too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_H
#define SERVER_ANSWER_H

#include "server/response.h"

/* answer_service.c: routes that need no dataset; false for the others. */
bool answer_service(struct services *s, const struct request *r, const struct target *t,
                    struct response *out);
/* answer_dataset.c: collections, tilesets, prefetch lists, moving addresses; false for others. */
bool answer_dataset(struct services *s, const struct request *r, struct dataset *d,
                    const struct target *t, struct response *out);
/* answer_tile.c */
void answer_tile(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out);
/* answer_view.c: GET of a view, POST of a camera. */
void answer_view(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out);
void answer_render(struct services *s, const struct request *r, struct dataset *d,
                   struct response *out);
/* answer_motion.c: GET of a stream, which exchange.c begins (out->stream), POST of its camera. */
void answer_motion(struct services *s, const struct request *r, struct dataset *d,
                   const struct target *t, struct response *out);
/* answer_view.c: false, with the problem set, when pictures cannot be made or this one is too
 * large, or too much would be drawn for it. Settles how fine it is drawn. */
bool answer_view_check(struct services *s, uint32_t width_px, uint32_t height_px, enum format f,
                       struct paint *paint, struct response *out);
/* answer_map.c: tiles of a map and of terrain, and the documents that lead to them; false for other
 * routes. */
bool answer_map(struct services *s, const struct request *r, struct dataset *d,
                const struct target *t, struct response *out);
/* answer_map.c: false, with the problem set, where nothing was surveyed: there are no maps then and
 * no heights. */
bool answer_is_surveyed(const struct dataset *d, struct response *out);
/* answer_query.c: questions about the surface; false for other routes. */
bool answer_query(struct services *s, const struct request *r, struct dataset *d,
                  const struct target *t, struct response *out);
/* answer_view.c: false, with the problem set, when nothing can be drawn. Sets out->unnamed while
 * the device starts: ask before the result is named. */
bool answer_can_draw(struct services *s, struct response *out);
/* answer_appearance.c: the list, one appearance, a posted mix, network, photographs and thumbnails;
 * false for other routes. */
bool answer_appearance(struct services *s, const struct request *r, struct dataset *d,
                       const struct target *t, struct response *out);
/* answer_kept.c: an appearance under a name: read, kept, forgotten. */
void answer_kept(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out);
/* answer_kept.c: a name in t->appearance becomes what it stands for, and t->kept the name. False,
 * with the problem set: it means nothing in this revision. */
bool answer_resolve(struct services *s, const struct dataset *d, struct target *t,
                    struct response *out);
/* The status of how a change ended that a job made (work.h). */
int answer_kept_status(enum err_code rc);
/* The appearance that a target or a body asks for; false, with the problem set, when there is none
 * such. Tiles may also have none applied to them. */
bool answer_find_tile_appearance(struct services *s, const struct dataset *d, const char *text,
                                 struct appearance_choice *out, struct response *res);
bool answer_find_appearance(struct services *s, const struct dataset *d, const char *text,
                            struct appearance_choice *out, struct response *res);

#endif
