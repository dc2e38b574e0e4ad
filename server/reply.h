/* From a response to libmicrohttpd's. The most frequent ones are kept made.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_REPLY_H
#define SERVER_REPLY_H

#include <microhttpd.h>

#include "server/response.h"

struct replies; /* of one listener; any thread */
/* reply_close it when no connection is left. ERR_MEM. */
enum err_code reply_open(struct replies **out, struct err *e) ERR_USE;
void reply_close(struct replies **rs);
/* Answer with r, whose body the caller holds until the request has ended; last: the connection ends
 * behind it. False: out of memory, the connection is to be closed. */
bool reply_send(struct replies *rs, struct MHD_Connection *c, const struct response *r, bool last);
/* The same with the headers of r and bytes that read(cls, ...) gives, until it says that they end;
 * at most `block` of them at a time. */
bool reply_stream(struct MHD_Connection *c, const struct response *r, size_t block,
                  MHD_ContentReaderCallback read, void *cls);

#endif
