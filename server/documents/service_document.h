/* Documents about the service: landing page and conformance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SERVICE_DOCUMENT_H
#define SERVER_SERVICE_DOCUMENT_H

#include "server/base/body.h"

/* The caller owns the reference. ERR_MEM. */
enum err_code service_document_landing(struct body **out, struct err *e) ERR_USE;
enum err_code service_document_conformance(struct body **out, struct err *e) ERR_USE;

#endif
