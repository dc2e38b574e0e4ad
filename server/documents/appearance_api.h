/* The appearance API: the appearances of a dataset, and the one that a request names.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_API_H
#define SERVER_APPEARANCE_API_H

#include "core/splat/appearance.h"
#include "server/data/dataset.h"
#include "server/data/named_appearance.h"
#include "server/route/target.h"

#define APPEARANCE_NONE "none" /* for tiles: trained colours */

struct appearance_choice { /* {0} is the default appearance */
    bool set;
    bool trained; /* APPEARANCE_NONE: no appearance is applied; `set` is false */
    float image[APPEARANCE_IMAGE_MAX]; /* embedding, [len_image] */
    struct hash128 hash;               /* of the embedding */
};
/* Finds the appearance that a text names (bake_find). "" and BAKE_DEFAULT name the default
 * appearance. In a dataset without appearances APPEARANCE_NONE also names the default one.
 * ERR_NOENT: there is no such appearance.
 * ERR_ARG: the text is invalid. */
enum err_code appearance_api_find(const struct dataset *d, const char *text,
                                  struct appearance_choice *out, struct err *e) ERR_USE;
/* The embedding of a choice; NULL: the default one. */
const float *appearance_api_image(const struct appearance_choice *c);
/* Replaces `text`, if it is a named appearance of t (may be NULL), by its meaning, and sets `name`
 * to the name; else name is "". The name of a photograph is never a named appearance. ERR_NOENT:
 * its embedding is for another network. */
enum err_code appearance_api_resolve(const struct dataset *d,
                                     const struct named_appearance_table *t,
                                     char text[TARGET_APPEARANCE_MAX], char name[TARGET_KEPT_MAX],
                                     struct err *e) ERR_USE;
/* The embedding of a named appearance in this dataset. ERR_NOENT, ERR_ARG: it has no meaning there.
 */
enum err_code appearance_api_find_kept(const struct dataset *d,
                                       const struct named_appearance_row *row,
                                       struct appearance_choice *out, struct err *e) ERR_USE;
/* Parses a body that names an appearance, into row->text and row->model. t: names that it may use,
 * or NULL. ERR_ARG is 409: the name is that of a photograph. Else as appearance_api_read_mix. */
enum err_code appearance_api_read_kept(const struct dataset *d,
                                       const struct named_appearance_table *t, const void *body,
                                       size_t n, struct named_appearance_row *row,
                                       struct err *e) ERR_USE;
/* Make the document of a single appearance, named or not. ERR_NOENT, ERR_ARG as above; ERR_MEM. */
enum err_code appearance_api_describe_kept(const struct dataset *d,
                                           const struct named_appearance_row *row,
                                           struct body **out, struct err *e) ERR_USE;
enum err_code appearance_api_describe(const struct dataset *d, const char *text, struct body **out,
                                      struct err *e) ERR_USE;
/* Parses a posted mix into the text of an appearance. ERR_FORMAT = 400, ERR_DATA = 422, ERR_NOENT =
 * 404, ERR_MEM. */
enum err_code appearance_api_read_mix(const struct dataset *d, const void *body, size_t n,
                                      char text[TARGET_APPEARANCE_MAX], struct err *e) ERR_USE;

#endif
