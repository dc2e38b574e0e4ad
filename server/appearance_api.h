/* The appearance API: which appearances a dataset has, and which one a request means.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_API_H
#define SERVER_APPEARANCE_API_H

#include "core/appearance.h"
#include "server/dataset.h"
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
/* The documents: all appearances of a dataset, one of them. ERR_NOENT, ERR_ARG as above;
 * ERR_MEM. */
enum err_code appearance_api_list(const struct dataset *d, struct body **out,
                                  struct err *e) ERR_USE;
enum err_code appearance_api_describe(const struct dataset *d, const char *text, struct body **out,
                                      struct err *e) ERR_USE;
/* The posted mix, as an appearance's text. ERR_FORMAT = 400, ERR_DATA = 422, ERR_NOENT = 404,
 * ERR_MEM. */
enum err_code appearance_api_read_mix(const struct dataset *d, const void *body, size_t n,
                                      char text[TARGET_APPEARANCE_MAX], struct err *e) ERR_USE;

#endif
