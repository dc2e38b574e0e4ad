/* The appearance that a request names.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_APPEARANCE_H
#define SERVER_ANSWER_APPEARANCE_H

#include "server/answers/response.h"

/* Finds the appearance of pictures that a text names. False: there is none; the problem is set. */
bool answer_appearance_find(struct services *s, const struct dataset *d, const char *text,
                            struct appearance_choice *out, struct response *res);
/* As answer_appearance_find, for tiles, which may also have no appearance applied. */
bool answer_appearance_find_tile(struct services *s, const struct dataset *d, const char *text,
                                 struct appearance_choice *out, struct response *res);
/* Replaces a named appearance in the target by its meaning, and sets names.kept to the name. False:
 * it has no meaning in this revision; the problem is set. */
bool answer_appearance_resolve(struct services *s, const struct dataset *d, struct target *t,
                               struct response *out);

#endif
