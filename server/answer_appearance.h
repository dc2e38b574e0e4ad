/* What a request says about an appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_APPEARANCE_H
#define SERVER_ANSWER_APPEARANCE_H

#include "server/response.h"

/* The appearance of pictures that a text names. False, with the problem set: there is none such. */
bool answer_appearance_find(struct services *s, const struct dataset *d, const char *text,
                            struct appearance_choice *out, struct response *res);
/* The same of tiles, which may also have none applied to them. */
bool answer_appearance_find_tile(struct services *s, const struct dataset *d, const char *text,
                                 struct appearance_choice *out, struct response *res);
/* A name in t->appearance becomes what it stands for, and t->kept the name. False, with the problem
 * set: it means nothing in this revision. */
bool answer_appearance_resolve(struct services *s, const struct dataset *d, struct target *t,
                               struct response *out);

#endif
