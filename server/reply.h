/* Turns a response into one of libmicrohttpd. The most frequent ones are kept.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_REPLY_H
#define SERVER_REPLY_H

#include <microhttpd.h>

#include "server/answers/response.h"

struct replies; /* for one listener; any thread */
/* Call reply_close when no connection is left. ERR_MEM. */
enum err_code reply_open(struct replies **out, struct err *e) ERR_USE;
void reply_close(struct replies **rs);
/* Answers with r. The caller holds its body until the request has ended. last: the connection
 * closes after it. False: out of memory; close the connection. */
bool reply_send(struct replies *rs, struct MHD_Connection *c, const struct response *r, bool last);
/* Answers with the headers of r and bytes from read(cls, ...), at most `block` at a time, until it
 * ends. */
bool reply_stream(struct MHD_Connection *c, const struct response *r, size_t block,
                  MHD_ContentReaderCallback read, void *cls);

#endif
