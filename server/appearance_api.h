/* The appearance API: which appearances a dataset has, and which one a request means.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_API_H
#define SERVER_APPEARANCE_API_H

#include "core/appearance.h"
#include "server/dataset.h"
#include "server/kept.h"
#include "server/target.h"

#define APPEARANCE_NONE "none" /* of tiles: colours as they were trained */

struct appearance_choice { /* {0} is the default appearance */
    bool set;
    bool trained;                      /* APPEARANCE_NONE: none is applied; set is false */
    float image[APPEARANCE_IMAGE_MAX]; /* embedding, [len_image] */
    struct hash128 hash;               /* of it */
};
/* The appearance that a text names (bake_find); "" and BAKE_DEFAULT are the default one, which
 * APPEARANCE_NONE is as well where a dataset has no other. ERR_NOENT: there is none such. ERR_ARG:
 * the text names none. */
enum err_code appearance_api_find(const struct dataset *d, const char *text,
                                  struct appearance_choice *out, struct err *e) ERR_USE;
/* Its embedding, NULL for the default one. */
const float *appearance_api_image(const struct appearance_choice *c);
/* If `text` is a name that is kept (t may be NULL), it becomes what that stands for, and `name` the
 * name; else name is "". A photograph's own name is never another one. ERR_NOENT: it stands for an
 * embedding of another network. */
enum err_code appearance_api_resolve(const struct dataset *d, const struct kept_table *t,
                                     char text[TARGET_APPEARANCE_MAX], char name[TARGET_KEPT_MAX],
                                     struct err *e) ERR_USE;
/* The embedding that a row stands for in this dataset. ERR_NOENT, ERR_ARG: it means nothing there.
 */
enum err_code appearance_api_find_kept(const struct dataset *d, const struct kept_row *row,
                                       struct appearance_choice *out, struct err *e) ERR_USE;
/* What a body asks to keep, in row->text and row->model; t: names that it may say, may be NULL. Of
 * its errors ERR_ARG is 409: the name is a photograph's. The others as of read_mix. */
enum err_code appearance_api_read_kept(const struct dataset *d, const struct kept_table *t,
                                       const void *body, size_t n, struct kept_row *row,
                                       struct err *e) ERR_USE;
/* The documents: all appearances of a dataset, with names that are kept (NULL: none); one of
 * either. ERR_NOENT, ERR_ARG as above; ERR_MEM. */
enum err_code appearance_api_list(const struct dataset *d, struct body **out,
                                  struct err *e) ERR_USE;
enum err_code appearance_api_write_list(const struct dataset *d, const struct kept_table *t,
                                        struct buf *out, struct err *e) ERR_USE;
enum err_code appearance_api_describe_kept(const struct dataset *d, const struct kept_row *row,
                                           struct body **out, struct err *e) ERR_USE;
enum err_code appearance_api_describe(const struct dataset *d, const char *text, struct body **out,
                                      struct err *e) ERR_USE;
/* The posted mix, as an appearance's text. ERR_FORMAT = 400, ERR_DATA = 422, ERR_NOENT = 404,
 * ERR_MEM. */
enum err_code appearance_api_read_mix(const struct dataset *d, const void *body, size_t n,
                                      char text[TARGET_APPEARANCE_MAX], struct err *e) ERR_USE;

#endif
